# SPDX-License-Identifier: Apache-2.0
#
# Debian's introspection for C++ finds the one for C, and that the generator for C: both register themselves. Nothing here reads
# messages in C, and they cost a third of the time that a message package takes to build.
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "^rosidl_(generator|typesupport_introspection)_c:")
