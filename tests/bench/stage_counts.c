// qemu plugin: what the program does between two calls of stage_boundary() (one_frame.cpp), one line for each stretch:
//
//   stretch INSTRUCTIONS LOADS STORES L1_LINES L2_LINES
//   function INSTRUCTIONS NAME         of the stretch above, for each function
//
// LOADS and STORES count instructions that access memory. Lines are of 64 bytes: those that a first-level cache fetches
// (32 KiB, four ways) and those that the second level behind it fetches from memory (512 KiB, sixteen ways), as a
// Cortex-A53 in a Pi Zero 2 W has them, least recently used first out, without its prefetching. Only data counts.
//
// qemu's API is declared here, because Debian packages no header of it. QEMU_API: 1 for qemu 7 and 8, 2 later.
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
typedef uint32_t qemu_plugin_meminfo_t;
typedef void (*TranslateCallback)(qemu_plugin_id_t id, struct qemu_plugin_tb* block);
typedef void (*RunCallback)(unsigned int cpu, void* data);
typedef void (*AccessCallback)(unsigned int cpu, qemu_plugin_meminfo_t info, uint64_t address, void* data);
void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t id, TranslateCallback callback);
void qemu_plugin_register_vcpu_tb_exec_cb(struct qemu_plugin_tb* block, RunCallback callback, int flags, void* data);
void qemu_plugin_register_vcpu_mem_cb(struct qemu_plugin_insn* insn, AccessCallback callback, int flags, int which,
                                      void* data);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb* block);
struct qemu_plugin_insn* qemu_plugin_tb_get_insn(const struct qemu_plugin_tb* block, size_t at);
const char* qemu_plugin_insn_symbol(const struct qemu_plugin_insn* insn);
bool qemu_plugin_mem_is_store(qemu_plugin_meminfo_t info);
unsigned int qemu_plugin_mem_size_shift(qemu_plugin_meminfo_t info);

enum { kNoRegisters = 0, kReadAndWrite = 3, kLineBits = 6 };
#define EXPORTED __attribute__((visibility("default")))
EXPORTED int qemu_plugin_version = QEMU_API;

// The most recently used line of a set is its first.
struct Cache {
  size_t n_sets;
  size_t n_ways;
  uint64_t* line;  // + 1; 0: none
  uint64_t n_fetched;
};

static struct Cache first_level = {.n_sets = 128, .n_ways = 4};
static struct Cache second_level = {.n_sets = 512, .n_ways = 16};

static bool fetches(struct Cache* cache, uint64_t line) {
  uint64_t* const set = cache->line + line % cache->n_sets * cache->n_ways;
  size_t way = 0;
  while (way + 1 < cache->n_ways && set[way] != line + 1) ++way;
  const bool is_new = set[way] != line + 1;
  memmove(set + 1, set, way * sizeof *set);
  set[0] = line + 1;
  cache->n_fetched += is_new;
  return is_new;
}

struct Function {
  char* name;
  uint64_t n;
  struct Function* next;
};
struct Block {
  struct Function* function;
  uint64_t n;
  bool is_boundary;
};

static struct Function* functions;
static uint64_t n_instructions, n_loads, n_stores;

static struct Function* function_named(const char* name) {
  for (struct Function* f = functions; f != NULL; f = f->next) {
    if (strcmp(f->name, name) == 0) return f;
  }
  struct Function* const f = calloc(1, sizeof *f);
  f->name = strdup(name);
  f->next = functions;
  return functions = f;
}

static void report(void) {
  fprintf(stderr, "stretch %" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64 " %" PRIu64 "\n", n_instructions, n_loads,
          n_stores, first_level.n_fetched, second_level.n_fetched);
  for (struct Function* f = functions; f != NULL; f = f->next) {
    if (f->n > 0) fprintf(stderr, "function %" PRIu64 " %s\n", f->n, f->name);
    f->n = 0;
  }
  n_instructions = n_loads = n_stores = first_level.n_fetched = second_level.n_fetched = 0;
}

static const void* last_instruction;  // one that accesses several elements is called back for each

static void on_run(unsigned int cpu, void* data) {
  (void)cpu;
  last_instruction = NULL;
  const struct Block* const block = data;
  if (block->is_boundary) report();
  n_instructions += block->n;
  block->function->n += block->n;
}

static void on_access(unsigned int cpu, qemu_plugin_meminfo_t info, uint64_t address, void* data) {
  (void)cpu;
  if (data != last_instruction) ++*(qemu_plugin_mem_is_store(info) ? &n_stores : &n_loads);
  last_instruction = data;
  const uint64_t last = (address + (1U << qemu_plugin_mem_size_shift(info)) - 1) >> kLineBits;
  for (uint64_t line = address >> kLineBits; line <= last; ++line) {
    if (fetches(&first_level, line)) fetches(&second_level, line);
  }
}

static void on_translate(qemu_plugin_id_t id, struct qemu_plugin_tb* translated) {
  (void)id;
  // Lives as long as the program; as large as its number of instructions, whose addresses tell them apart.
  struct Block* const block = calloc(1, sizeof *block + qemu_plugin_tb_n_insns(translated));
  const char* name = qemu_plugin_insn_symbol(qemu_plugin_tb_get_insn(translated, 0));
  block->function = function_named(name != NULL && *name != '\0' ? name : "?");
  block->is_boundary = strcmp(block->function->name, "stage_boundary") == 0;
  block->n = qemu_plugin_tb_n_insns(translated);
  qemu_plugin_register_vcpu_tb_exec_cb(translated, on_run, kNoRegisters, block);
  for (size_t i = 0; i < block->n; ++i) {
    qemu_plugin_register_vcpu_mem_cb(qemu_plugin_tb_get_insn(translated, i), on_access, kNoRegisters, kReadAndWrite,
                                     (char*)block + i);  // any address that is the instruction's own
  }
}

EXPORTED int qemu_plugin_install(qemu_plugin_id_t id, const void* info, int argc, char** argv) {
  (void)info;
  (void)argc;
  (void)argv;
  for (struct Cache* cache = &first_level; cache != NULL; cache = cache == &first_level ? &second_level : NULL) {
    cache->line = calloc(cache->n_sets * cache->n_ways, sizeof *cache->line);
  }
  qemu_plugin_register_vcpu_tb_trans_cb(id, on_translate);
  return 0;
}
