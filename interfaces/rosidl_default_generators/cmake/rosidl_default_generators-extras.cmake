# SPDX-License-Identifier: Apache-2.0
#
# Debian's introspection for C++ finds the one for C, and that one the generator for C: both
# register themselves. They cost a third of the build time of a message package, so only one that
# says AGNOCAST_GENERATE_C has its messages in C as well: the messages of tests, for what converts
# between the two.
if(NOT AGNOCAST_GENERATE_C)
  list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX
    "^rosidl_(generator|typesupport_introspection)_c:")
endif()
