# cmake -DINPUT=ruffini.desc -DOUTPUT=schema.h -P embed_schema.cmake: the schema that the device serves.
file(READ ${INPUT} bytes HEX)
file(SHA256 ${INPUT} hash)
string(LENGTH "${bytes}" n)
math(EXPR n "${n} / 2")
string(REGEX REPLACE "([0-9a-f][0-9a-f])" "0x\\1," bytes "${bytes}")
string(REGEX REPLACE "([0-9a-f][0-9a-f])" "0x\\1," hash "${hash}")
file(WRITE ${OUTPUT} "// FileDescriptorSet of ruffini.proto.
#pragma once

#include <cstddef>
#include <cstdint>

namespace ruffini {
inline constexpr size_t kSchemaSize = ${n};
inline constexpr uint8_t kSchemaBytes[] = {${bytes}};
inline constexpr uint8_t kSchemaSha256[] = {${hash}};
}  // namespace ruffini
")
