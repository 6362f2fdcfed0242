# What is installed where, and the Debian packages of it (`make deb`): ruffinid for the board, libruffini-dev for
# programs of others, ruffini for the host. tests/deploy/installed.py looks whether it is all there.
include(GNUInstallDirs)
set(DEPLOY ${CMAKE_SOURCE_DIR}/firmware/deploy)

install(TARGETS ruffinid RUNTIME DESTINATION bin COMPONENT ruffinid)
install(TARGETS ruffini_infer ruffini_pictures LIBRARY DESTINATION lib/ruffini COMPONENT ruffinid)
install(DIRECTORY boards/ DESTINATION share/ruffini/boards COMPONENT ruffinid FILES_MATCHING PATTERN board.toml)
install(PROGRAMS ${DEPLOY}/ruffini-gadget DESTINATION lib/ruffini COMPONENT ruffinid)
install(PROGRAMS ${DEPLOY}/ruffini-doctor DESTINATION sbin COMPONENT ruffinid)
install(FILES ${DEPLOY}/ruffinid.service ${DEPLOY}/ruffini-gadget.service DESTINATION lib/systemd/system
  COMPONENT ruffinid)
install(FILES ${DEPLOY}/ruffinid.env DESTINATION /etc/ruffini COMPONENT ruffinid)
install(FILES ${DEPLOY}/60-ruffinid.rules DESTINATION lib/udev/rules.d COMPONENT ruffinid)
install(FILES ${DEPLOY}/sysusers.conf DESTINATION lib/sysusers.d RENAME ruffinid.conf COMPONENT ruffinid)
install(FILES ${DEPLOY}/tmpfiles.conf DESTINATION lib/tmpfiles.d RENAME ruffinid.conf COMPONENT ruffinid)
install(FILES ${DEPLOY}/README.md DESTINATION share/doc/ruffinid COMPONENT ruffinid)
install(FILES LICENSE DESTINATION share/doc/ruffinid RENAME copyright COMPONENT ruffinid)

install(TARGETS ruffini LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT dev)
install(FILES firmware/capi/ruffini_core.h DESTINATION include/ruffini COMPONENT dev)
install(FILES proto/ruffini.proto proto/README.md DESTINATION share/ruffini/proto COMPONENT dev)
install(FILES LICENSE DESTINATION share/doc/libruffini-dev RENAME copyright COMPONENT dev)

set(PYTHON lib/python3/dist-packages)
install(DIRECTORY host/ruffini DESTINATION ${PYTHON} COMPONENT host PATTERN __pycache__ EXCLUDE PATTERN _native EXCLUDE)
install(DIRECTORY boards/ DESTINATION ${PYTHON}/ruffini/boards/data COMPONENT host)
install(TARGETS ruffini LIBRARY DESTINATION ${PYTHON}/ruffini/_native COMPONENT host)
install(FILES ${SCHEMA} DESTINATION ${PYTHON}/ruffini/_native COMPONENT host)
# The viewer's page comes from the build outside the root, where npm is.
install(DIRECTORY ${CMAKE_SOURCE_DIR}/build/native/page DESTINATION ${PYTHON}/ruffini/_native COMPONENT host)
install(PROGRAMS ${DEPLOY}/ruffini DESTINATION bin COMPONENT host)
install(FILES host/ruffini/device/70-ruffini.rules DESTINATION lib/udev/rules.d COMPONENT host)
install(FILES LICENSE DESTINATION share/doc/ruffini RENAME copyright COMPONENT host)
# Python packages that Debian has not, or not new enough: a folder that pip filled, for this one Python.
install(DIRECTORY ${RUFFINI_VENDORED}/ DESTINATION lib/ruffini/python COMPONENT host PATTERN __pycache__ EXCLUDE)

set(CPACK_GENERATOR DEB)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_COMPONENTS_ALL ruffinid dev host)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_MAINTAINER "ruffini developers <ruffini@localhost>")
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
if(CMAKE_CROSSCOMPILING)
  set(CPACK_DEBIAN_PACKAGE_ARCHITECTURE arm64)
endif()
set(CPACK_DEBIAN_RUFFINID_PACKAGE_NAME ruffinid)
set(CPACK_DEBIAN_RUFFINID_PACKAGE_SECTION misc)
# A camera on the board's own connector needs libcamera's IPA modules.
set(CPACK_DEBIAN_RUFFINID_PACKAGE_DEPENDS "systemd, udev, libcamera-ipa")
set(CPACK_DEBIAN_RUFFINID_DESCRIPTION "Newtons from a camera that looks at a soft pad: the sensor's program")
set(CPACK_DEBIAN_RUFFINID_PACKAGE_CONTROL_EXTRA "${DEPLOY}/debian/postinst;${DEPLOY}/debian/prerm;${DEPLOY}/debian/conffiles")
set(CPACK_DEBIAN_DEV_PACKAGE_NAME libruffini-dev)
set(CPACK_DEBIAN_DEV_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_DEV_DESCRIPTION "The sensor's computation as a C library, and its protocol")
set(CPACK_DEBIAN_HOST_PACKAGE_NAME ruffini)
set(CPACK_DEBIAN_HOST_PACKAGE_SECTION science)
set(CPACK_DEBIAN_HOST_DESCRIPTION "Host tool of ruffini sensors: simulate, calibrate, flash, record, show")
math(EXPR PYTHON_AFTER "${RUFFINI_PYTHON_MINOR} + 1")
set(CPACK_DEBIAN_HOST_PACKAGE_DEPENDS "python3 (>= 3.${RUFFINI_PYTHON_MINOR}~), python3 (<< 3.${PYTHON_AFTER}~), \
python3-aiohttp, python3-h5py, python3-lz4, python3-matplotlib, python3-nacl, python3-numpy, python3-opencv, \
python3-pydantic (>= 2.6), python3-rich, python3-scipy, python3-serial, python3-smbus2, python3-threadpoolctl, \
python3-shellingham, python3-zstandard")
include(CPack)
