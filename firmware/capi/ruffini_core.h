/* C interface of the core: the device's own arithmetic for offline use (ctypes).
 *
 * Every function returns 0 on success; otherwise the text of ruffini_error() says what, where and
 * what to do. A handle belongs to one thread at a time. Arrays are C order, sizes as documented by
 * ruffini_layout. */
#ifndef RUFFINI_CORE_H
#define RUFFINI_CORE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define RUFFINI_API __attribute__((visibility("default")))

typedef struct ruffini_pipeline ruffini_pipeline;

typedef struct {
  int32_t width_px, height_px;
  int32_t depth_n_x, depth_n_y, depth_step_px;
  int32_t node_n_x, node_n_y;         /* observed nodes */
  int32_t node_first_x, node_first_y; /* within the pad's grid */
  int32_t marker_n_x, marker_n_y;
  int32_t force_lsb_un;
  int32_t n_targets;
} ruffini_layout_t;

typedef struct {
  uint32_t flags;                   /* FlagBit of ruffini.proto */
  int32_t force_xy, force_z, depth; /* Validity of ruffini.proto */
  int32_t wrench_validity[6];
  int32_t n_markers_lost, n_markers_at_rest;
  uint64_t saturations; /* since ruffini_open */
  int64_t wrench[6];    /* uN, uN um */
  int32_t n_contacts;
} ruffini_result_t;

RUFFINI_API const char* ruffini_version(void);
/* "vector" if the kernels are those of the processor's vector instructions (AVX2, NEON), "scalar" if not: the results
 * are equal, at a third of the speed. */
RUFFINI_API const char* ruffini_kernels(void);
/* Of the last failed call on this thread. */
RUFFINI_API const char* ruffini_error(void);
/* A board.toml as JSON: keys sorted, decimal integers, defaults of absent keys filled in. NULL with ruffini_error() if
 * the parser refuses the file, which `where` names. The text is valid until the next call on this thread. */
RUFFINI_API const char* ruffini_board_json(const char* toml, size_t toml_bytes, const char* where);

/* `calibration` may be NULL. The signature is not checked here: files from this machine are the caller's. */
RUFFINI_API ruffini_pipeline* ruffini_open(const char* toml, size_t toml_bytes, const char* where,
                                           const uint8_t* calibration, size_t calibration_bytes);
RUFFINI_API void ruffini_close(ruffini_pipeline* pipeline);
RUFFINI_API int ruffini_layout(const ruffini_pipeline* pipeline, ruffini_layout_t* out);

/* B, G, R, width x height of the board. capture_us: time of capture, for the pad's relaxation; 0 leaves that out. */
RUFFINI_API int ruffini_process(ruffini_pipeline* pipeline, const uint8_t* bgr, int32_t width_px, int32_t height_px,
                                uint64_t capture_us, ruffini_result_t* out);
/* Of a calibration with kind `views`: places [n][4] px Q16 of the frame, x and y in the first view, x and y in the
 * second, to [n][4] um Q8: x, y, z, and the gap between the two rays; INT32_MIN four times where they do not meet. */
RUFFINI_API int ruffini_triangulate(const ruffini_pipeline* pipeline, const int32_t* places_q16, int32_t n,
                                    int32_t* out);
/* The wrench of features alone, as the frame path has it (stages/feature_wrench/feature_wrench.h): kind `wrench` of a
 * calibration for `n` features of this sort, without a board. NULL on failure. */
typedef struct ruffini_wrench ruffini_wrench;
RUFFINI_API ruffini_wrench* ruffini_wrench_open(const uint8_t* calibration, size_t calibration_bytes,
                                                const char* features, int32_t n);
RUFFINI_API void ruffini_wrench_close(ruffini_wrench* wrench);
/* Frames one after the other: features [frames][n], capture_us [frames] to wrench [frames][6] (uN, uN um), covariance
 * [frames][21] ((uN, uN mm)^2) and state [frames]: bit 0 features contradict each other, bit 1 out of range. */
RUFFINI_API int ruffini_wrench_run(ruffini_wrench* wrench, const int32_t* features, const uint64_t* capture_us,
                                   int32_t n_frames, int64_t* out, int64_t* covariance, uint8_t* state);
RUFFINI_API int ruffini_zero(ruffini_pipeline* pipeline, int32_t n_frames);
/* Rest image [height][width][3] in 1/16 grey levels, in force at once. */
RUFFINI_API int ruffini_set_rest(ruffini_pipeline* pipeline, const uint16_t* image);
/* Frames are a live camera's from the next on: repeated and broken pictures are flagged, and creep is followed. */
RUFFINI_API int ruffini_set_live(ruffini_pipeline* pipeline, int32_t is_live);
/* Of the pad, thousandths of a degree Celsius, from the next frame on; INT32_MIN: not measured. */
RUFFINI_API int ruffini_set_temperature(ruffini_pipeline* pipeline, int32_t milli_celsius);

/* The solve alone on n_frames displacements, [frame][node][3] steps of 125 nm -> [frame][node][3] force steps. */
RUFFINI_API int ruffini_solve(ruffini_pipeline* pipeline, const int16_t* displacement, int32_t n_frames,
                              int32_t* force);

/* The results of the last processed frame, as arrays: each shows one slot that a stage of this board writes with this
 * calibration (firmware/core/slots.h). Learned once, by name; the list and the shapes are those of the
 * open pipeline. */
typedef struct {
  const char* name;
  const char* type;    /* as numpy names it: u1, i2, i4, i8 */
  const char* unit;    /* of one step */
  const char* columns; /* names of the last axis, separated by spaces; empty: its values are of one sort */
  int32_t n_axes;
  int32_t shape[3]; /* 1 beyond n_axes */
} ruffini_slot_t;
RUFFINI_API int32_t ruffini_slot_count(const ruffini_pipeline* pipeline);
RUFFINI_API int ruffini_slot_describe(const ruffini_pipeline* pipeline, int32_t index, ruffini_slot_t* out);
/* Copies the array, C order; *n_rows of its first axis are valid: fewer than its length for lists, such as contacts.
 * Fails if the board has no slot of this name, the buffer is too small, or the last frame does not state it (sigma,
 * covariance, residual). The residual is computed when it is asked for. */
RUFFINI_API int ruffini_get_slot(ruffini_pipeline* pipeline, const char* name, void* out, size_t out_bytes,
                                 int32_t* n_rows);

/* The features that the board's wrench is made of, whether or not this calibration lets a stage compute them. */
typedef struct {
  const char* sort; /* of the calibration's `wrench.features`; empty: no stage of the board writes any */
  int32_t n;
  int32_t n_planes; /* of values over a grid, plane by plane; 0: others */
  int32_t n_y;
  int32_t n_x;
} ruffini_features_t;
RUFFINI_API int ruffini_features(const ruffini_pipeline* pipeline, ruffini_features_t* out);

/* The stages that a board may list, in their order; NULL beyond. Nanoseconds of each in the last frame, 0: not run. */
RUFFINI_API int32_t ruffini_stage_count(void);
RUFFINI_API const char* ruffini_stage_name(int32_t index);
/* The slots that this stage writes (firmware/core/slots.h), with spaces between; NULL beyond. */
RUFFINI_API const char* ruffini_stage_writes(int32_t index);
RUFFINI_API int ruffini_stage_times(const ruffini_pipeline* pipeline, uint64_t* ns);

#ifdef __cplusplus
}
#endif
#endif
