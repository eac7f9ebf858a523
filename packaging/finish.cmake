# cpack runs this when the files of the packages are in place and the version is known.
string(TIMESTAMP date "%a, %d %b %Y %H:%M:%S +0000" UTC)
foreach(package IN LISTS CPACK_COMPONENTS_ALL)
  set(version ${CPACK_PACKAGE_VERSION}-${CPACK_DEBIAN_PACKAGE_RELEASE})
  set(changelog ${CPACK_TEMPORARY_DIRECTORY}/${package}/usr/share/doc/${package}/changelog.Debian)
  file(WRITE ${changelog} "${CPACK_DEBIAN_PACKAGE_SOURCE} (${version}) unstable; urgency=medium

  * Version ${CPACK_PACKAGE_VERSION}.

 -- ${CPACK_PACKAGE_CONTACT}  ${date}
")
  execute_process(COMMAND gzip -9 -n -f ${changelog} COMMAND_ERROR_IS_FATAL ANY)
endforeach()
# The programs have an RPATH to the libraries beside them; packages install these where the loader
# looks.
foreach(program agnocast-ctl/usr/libexec/agnocast/agnocast-ctl-topic
  agnocast-bridge/usr/bin/agnocast-bridge)
  if(EXISTS ${CPACK_TEMPORARY_DIRECTORY}/${program})
    file(RPATH_REMOVE FILE ${CPACK_TEMPORARY_DIRECTORY}/${program})
  endif()
endforeach()
