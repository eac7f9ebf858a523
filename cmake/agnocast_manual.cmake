# agnocast_manual(PAGE): builds and installs a manual page from the build directory, compressed
# reproducibly. agnocast_manual_date is the date for generated pages: that of the build, or of
# SOURCE_DATE_EPOCH.
string(TIMESTAMP agnocast_manual_date "%B %d, %Y" UTC)
# As mdoc(7) writes a day below the tenth.
string(REPLACE " 0" " " agnocast_manual_date "${agnocast_manual_date}")
find_program(GZIP_PROGRAM gzip REQUIRED)

function(agnocast_manual page)
  set(file ${CMAKE_CURRENT_BINARY_DIR}/${page})
  add_custom_command(OUTPUT ${file}.gz COMMAND ${GZIP_PROGRAM} -9 -n -k -f ${file} DEPENDS ${file}
    VERBATIM)
  set(all ALL)
  if(AGNOCAST_SANITIZE)
    set(all)
  endif()
  add_custom_target(manual_${page} ${all} DEPENDS ${file}.gz)
  string(REGEX REPLACE ".*\\." "" section ${page})
  install(FILES ${file}.gz DESTINATION ${CMAKE_INSTALL_MANDIR}/man${section})
endfunction()
