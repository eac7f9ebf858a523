// SPDX-License-Identifier: Apache-2.0
//
// Stands for the library of the kernel-module system, whose heap hook calls this function.

extern "C" __attribute__((visibility("default"))) void initialize_agnocast() {}
