# find_package(agnocast) for installed trees: target agnocast::agnocast.
include(CMakePackageConfigHelpers)
set(config_dir ${CMAKE_INSTALL_LIBDIR}/cmake/agnocast)
configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/agnocastConfig.cmake.in
  ${CMAKE_CURRENT_BINARY_DIR}/agnocastConfig.cmake INSTALL_DESTINATION ${config_dir})
# Before 1.0 every minor version may change the interface.
write_basic_package_version_file(${CMAKE_CURRENT_BINARY_DIR}/agnocastConfigVersion.cmake
  COMPATIBILITY SameMinorVersion)
install(EXPORT agnocast NAMESPACE agnocast:: FILE agnocastTargets.cmake DESTINATION ${config_dir})
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/agnocastConfig.cmake
  ${CMAKE_CURRENT_BINARY_DIR}/agnocastConfigVersion.cmake
  DESTINATION ${config_dir})
# Files that colcon and ament look for.
install(FILES package.xml DESTINATION ${CMAKE_INSTALL_DATADIR}/agnocast)
file(TOUCH ${CMAKE_CURRENT_BINARY_DIR}/ament_index_marker)
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/ament_index_marker
  DESTINATION ${CMAKE_INSTALL_DATADIR}/ament_index/resource_index/packages RENAME agnocast)
# colcon.pkg names these: a package with build type cmake is not in AMENT_PREFIX_PATH by itself.
install(DIRECTORY ${CMAKE_CURRENT_LIST_DIR}/environment
  DESTINATION ${CMAKE_INSTALL_DATADIR}/agnocast)
