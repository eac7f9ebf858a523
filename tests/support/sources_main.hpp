// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace agnocast::test {

/// Runs the tests of the program that the command line selects (sources_main.cpp). Returns the exit
/// status.
int run_tests(int argc, char** argv);

}  // namespace agnocast::test
