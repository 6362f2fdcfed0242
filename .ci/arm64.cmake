# Cross-compiles all of it for 64-bit ARM in a root that has Debian's arm64 packages beside its own: `make arm64`.
include(${CMAKE_CURRENT_LIST_DIR}/aarch64.cmake)
set(CMAKE_LIBRARY_ARCHITECTURE aarch64-linux-gnu)
set(PKG_CONFIG_EXECUTABLE aarch64-linux-gnu-pkg-config)
