# Eclipse Cyclone DDS: target agnocast_ddsc and program AGNOCAST_IDLC, each only if it is found.
# Searched by hand: Debian's CMake package of Cyclone DDS fails if cyclonedds-tools is not
# installed.
find_program(AGNOCAST_IDLC idlc DOC "IDL compiler of Eclipse Cyclone DDS")
find_library(AGNOCAST_DDSC ddsc DOC "Eclipse Cyclone DDS")
find_path(AGNOCAST_DDS_INCLUDE dds/dds.h)
if(AGNOCAST_DDSC AND AGNOCAST_DDS_INCLUDE)
  add_library(agnocast_ddsc INTERFACE)
  # Suppress warnings in its headers.
  target_include_directories(agnocast_ddsc SYSTEM INTERFACE ${AGNOCAST_DDS_INCLUDE})
  target_link_libraries(agnocast_ddsc INTERFACE ${AGNOCAST_DDSC})
endif()

# agnocast_idl(TARGET FILE): a static library of the code that idlc generates from FILE.
function(agnocast_idl target file)
  get_filename_component(name ${file} NAME_WE)
  set(generated ${CMAKE_CURRENT_BINARY_DIR}/${name}.c ${CMAKE_CURRENT_BINARY_DIR}/${name}.h)
  add_custom_command(OUTPUT ${generated} COMMAND ${AGNOCAST_IDLC} -l c
    ${CMAKE_CURRENT_SOURCE_DIR}/${file}
    WORKING_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR} DEPENDS ${file} VERBATIM)
  add_library(${target} STATIC ${generated})
  target_include_directories(${target} SYSTEM PUBLIC ${CMAKE_CURRENT_BINARY_DIR})
  target_link_libraries(${target} PUBLIC agnocast_ddsc)
endfunction()
