// SPDX-License-Identifier: Apache-2.0
//
// main() of every GoogleTest program, unless it has its own. A program may hold the tests of
// several CTest entries, and each entry names its sources (agnocast_test(… PROGRAM …)).
//   PROGRAM [--source=FILE]… [GoogleTest's options]
//     --source   only the tests of this file, without its folder; a file without tests is an error

#include <tests/support/sources_main.hpp>

#include <gmock/gmock.h>

#include <cstdio>
#include <string>
#include <string_view>

namespace {

/// Adds the names of the tests of one file to a filter of GoogleTest. Returns whether it has any.
bool add_tests_of(std::string_view source, std::string& filter) {
  bool found = false;
  const testing::UnitTest& all = *testing::UnitTest::GetInstance();
  for (int i = 0; i < all.total_test_suite_count(); ++i) {
    const testing::TestSuite& suite = *all.GetTestSuite(i);
    for (int j = 0; j < suite.total_test_count(); ++j) {
      const testing::TestInfo& test = *suite.GetTestInfo(j);
      std::string_view file = test.file();
      file.remove_prefix(file.rfind('/') + 1);
      if (file != source) continue;
      filter += std::string(test.test_suite_name()) + "." + test.name() + ":";
      found = true;
    }
  }
  return found;
}

}  // namespace

int agnocast::test::run_tests(int argc, char** argv) {
  testing::InitGoogleMock(&argc, argv);
  std::string filter;
  for (int i = 1; i < argc; ++i) {
    const std::string_view argument = argv[i];
    constexpr std::string_view option = "--source=";
    if (!argument.starts_with(option)) continue;
    if (add_tests_of(argument.substr(option.size()), filter)) continue;
    std::fprintf(stderr, "%s has no tests in this program\n", argv[i] + option.size());
    return 2;
  }
  if (!filter.empty()) GTEST_FLAG_SET(filter, filter);
  return RUN_ALL_TESTS();
}

[[gnu::weak]] int main(int argc, char** argv) { return agnocast::test::run_tests(argc, argv); }
