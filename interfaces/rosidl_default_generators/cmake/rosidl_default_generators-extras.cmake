# SPDX-License-Identifier: Apache-2.0
#
# Debian's introspection for C++ finds the one for C, and that one the generator for C: both register themselves.
# Nothing here reads messages in C, and they cost a third of the build time of a message package.
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "^rosidl_(generator|typesupport_introspection)_c:")
