# Writes OUTPUT with the revision of the tree SOURCE, if it has changed: cmake -DSOURCE=… -DOUTPUT=…
# -P revision.cmake. It neither waits for nor takes the lock of the git index: another program may
# be using it.
cmake_minimum_required(VERSION 3.22)
set(ENV{GIT_OPTIONAL_LOCKS} 0)
execute_process(COMMAND git describe --always --dirty WORKING_DIRECTORY ${SOURCE}
  OUTPUT_VARIABLE revision OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE ignored)
file(CONFIGURE OUTPUT ${OUTPUT} @ONLY CONTENT "\
#include <bench/environment.hpp>
namespace agnocast::bench {
const char* const revision = \"@revision@\";
}
")
