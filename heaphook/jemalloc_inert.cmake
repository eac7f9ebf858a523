# Makes jemalloc_inert.o: Debian's libjemalloc_pic.a as one object file that is inert until it is
# called.
#
#   cmake -DARCHIVE=libjemalloc_pic.a -DOUTPUT=jemalloc_inert.o -DCOMPILER=… -DAR=… -DNM=…
#     -DOBJCOPY=… -P jemalloc_inert.cmake
#
# A separate jemalloc library would take over malloc of the whole process, start in a constructor
# and read the user's MALLOC_CONF. Here
#   - its C++ operators are left out (they need libstdc++; ours are in operators.cpp),
#   - every symbol gets the prefix agnocast_je_, so that it does not clash with another jemalloc,
#   - the functions that read outside configuration, and those of libm and libgcc_s that only its
#     profiler uses, are renamed too: jemalloc_inert.cpp replaces them,
#   - its constructor is dropped: it starts with the first call, at attach.
cmake_minimum_required(VERSION 3.22)

macro(run)
  execute_process(COMMAND ${ARGN} COMMAND_ERROR_IS_FATAL ANY)
endmacro()

set(archive ${OUTPUT}.a)
set(whole ${OUTPUT}.whole.o)
set(names ${OUTPUT}.names)

configure_file(${ARCHIVE} ${archive} COPYONLY)
run(${AR} d ${archive} jemalloc_cpp.pic.o)
run(${COMPILER} -r -nostdlib -o ${whole} -Wl,--whole-archive ${archive})

execute_process(COMMAND ${NM} -g --defined-only ${whole} OUTPUT_VARIABLE symbols
  COMMAND_ERROR_IS_FATAL ANY)
string(REGEX MATCHALL "[^\n]+" lines "${symbols}")
set(renames "")
foreach(line IN LISTS lines)
  string(REGEX REPLACE "^[^ ]* . " "" symbol "${line}")
  # jemalloc's internal names begin with je_ already.
  string(REGEX REPLACE "^je_" "internal_" short "${symbol}")
  string(APPEND renames "${symbol} agnocast_je_${short}\n")
endforeach()
foreach(symbol secure_getenv readlink exp log round _Unwind_Backtrace _Unwind_GetIP)
  string(APPEND renames "${symbol} agnocast_je_${symbol}\n")
endforeach()
file(WRITE ${names} "${renames}")

run(${OBJCOPY} --redefine-syms=${names} --remove-section=.init_array
  --remove-section=.rela.init_array
  --remove-section=.comment ${whole} ${OUTPUT})
file(REMOVE ${archive} ${whole} ${names})
