// SPDX-License-Identifier: Apache-2.0
//
// The functions of toml++: its headers declare them alone (TOML_HEADER_ONLY=0), because every
// source that reads a configuration would compile them otherwise.
#define TOML_IMPLEMENTATION
#include <toml++/toml.h>
