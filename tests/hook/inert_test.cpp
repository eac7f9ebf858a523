// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process that merely loads the hook behaves as without it. Method: the same programs with
// and without LD_PRELOAD, compared by their output and /proc; binutils read the library itself.

#include "support.hpp"

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include <sys/auxv.h>
#include <sys/stat.h>
#include <unistd.h>

namespace {

using namespace hook_test;

const std::string programs = AGNOCAST_TEST_PROGRAMS;

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) lines.push_back(line);
  return lines;
}

TEST(HookInert, AddsNoDescriptorNoThreadAndNoMappingButItself) {
  const bool linked = hook_test::hook_is_linked();
  RunOptions options;
  const Outcome without = run({programs + "/hook_test_report"}, options);
  options.preload = !linked;
  const Outcome with =
      run({programs + (linked ? "/hook_test_report_linked" : "/hook_test_report")}, options);
  ASSERT_EQ(without.exit_status, 0) << without.error;
  ASSERT_EQ(with.exit_status, 0) << with.error;
  EXPECT_EQ(with.error, "");

  std::string rest;
  int own = 0;
  long anonymous_kib = 0;
  for (const std::string& line : lines_of(with.output)) {
    if (line.find("libagnocast_heaphook.so") != std::string::npos) {
      ++own;
      continue;
    }
    if (line.rfind("anonymous_kib ", 0) == 0) {
      anonymous_kib = std::stol(line.substr(14));
      continue;
    }
    std::string same = line;
    if (const std::size_t name = same.find("_report_linked"); name != std::string::npos)
      same.erase(name + 7, 7);
    rest += same + "\n";
  }
  EXPECT_GE(own, 3) << "the hook is not loaded";
  std::string expected;
  for (const std::string& line : lines_of(without.output)) {
    if (line.rfind("anonymous_kib ", 0) == 0) {
      // The loader keeps thread-local storage of libraries in its own pages: room for the hook's.
      EXPECT_NEAR(static_cast<double>(anonymous_kib), std::stod(line.substr(14)), 16);
    } else {
      expected += line + "\n";
    }
  }
  EXPECT_EQ(rest, expected);
}

TEST(HookInert, LibraryNeedsOnlyLibc) {
  const Outcome outcome = run({"readelf", "-dW", hook_path()});
  ASSERT_EQ(outcome.exit_status, 0) << outcome.error;
  std::set<std::string> needed;
  for (const std::string& line : lines_of(outcome.output)) {
    if (line.find("(NEEDED)") == std::string::npos) continue;
    const std::size_t open = line.find('[');
    needed.insert(line.substr(open + 1, line.find(']') - open - 1));
  }
  EXPECT_EQ(needed.count("libc.so.6"), 1u);
  needed.erase("libc.so.6");
  for (const std::string& name : needed) EXPECT_EQ(name.rfind("ld-linux", 0), 0u) << name;
}

TEST(HookInert, LibraryCannotReadTheEnvironmentOrEndTheProcessPolitely) {
  const Outcome outcome =
      run({"nm", "-D", "--undefined-only", "--without-symbol-versions", hook_path()});
  ASSERT_EQ(outcome.exit_status, 0) << outcome.error;
  std::set<std::string> used;
  for (const std::string& line : lines_of(outcome.output)) {
    std::istringstream words(line);
    for (std::string word; words >> word;) used.insert(word);
  }
  EXPECT_EQ(used.count("mmap"), 1u) << "the list of functions is incomplete";
  for (const char* name :
       {"getenv", "secure_getenv", "environ", "__environ", "exit", "printf", "fprintf", "stderr",
        "syslog", "__cxa_throw", "__gxx_personality_v0", "_Znwm"}) {
    EXPECT_EQ(used.count(name), 0u) << name;
  }
}

TEST(HookInert, LibraryExportsOnlyTheMallocFamilyAndItsTable) {
  const Outcome outcome =
      run({"nm", "-D", "--defined-only", "--without-symbol-versions", hook_path()});
  ASSERT_EQ(outcome.exit_status, 0) << outcome.error;
  int operators = 0;
  std::set<std::string> others;
  for (const std::string& line : lines_of(outcome.output)) {
    const std::string name = line.substr(line.rfind(' ') + 1);
    if (name.rfind("_Zn", 0) == 0 || name.rfind("_Zd", 0) == 0) {
      ++operators;
    } else {
      others.insert(name);
    }
  }
  EXPECT_EQ(operators, 20);
  EXPECT_EQ(others, (std::set<std::string>{"agnocast_heaphook", "aligned_alloc", "calloc", "free",
                                           "free_aligned_sized", "free_sized", "malloc",
                                           "malloc_usable_size", "memalign", "posix_memalign",
                                           "pvalloc", "realloc", "reallocarray", "valloc"}));
}

TEST(HookInert, ConfigurationOfAnotherJemallocIsNotOurs) {
  char self[4096] = {};
  ASSERT_GT(readlink("/proc/self/exe", self, sizeof self - 1), 0);
  RunOptions options;
  options.preload = !hook_test::hook_is_linked();
  options.environment = {"MALLOC_CONF=nonsense:1,confirm_conf:true,narenas:17,stats_print:true"};
  const Outcome outcome =
      run({self, "--in-own-process", "--gtest_filter=HookInert.AttachedBody", "--gtest_brief=1"},
          options);
  EXPECT_EQ(outcome.exit_status, 0) << outcome.output;
  EXPECT_EQ(outcome.error, "") << "jemalloc would complain here";
}

// Body for the tests around it: attaches and shares a block.
HOOKED_TEST(HookInert, AttachedBody) {
  hook_test::WindowFile file(64 * hook_test::MiB);
  hook_test::attach(file);
  hook_test::Scope scope;
  EXPECT_TRUE(hook_test::is_shared(hook_test::opaque(malloc(100))));
}

TEST(HookInert, TwoCopiesOfTheHookFormAChain) {
  Directory directory;
  const std::string other = directory.path + "/libagnocast_heaphook_other.so";
  std::filesystem::copy_file(hook_path(), other);
  char self[4096] = {};
  ASSERT_GT(readlink("/proc/self/exe", self, sizeof self - 1), 0);
  RunOptions options;
  options.environment = {"LD_PRELOAD=" + hook_path() + ":" + other};
  const Outcome outcome =
      run({self, "--in-own-process", "--gtest_filter=HookInert.AttachedBody", "--gtest_brief=1"},
          options);
  EXPECT_EQ(outcome.exit_status, 0) << outcome.output << outcome.error;
  EXPECT_NE(outcome.output.find("[  PASSED  ] 1 test"), std::string::npos) << outcome.output;
}

// Body of the setuid copy; nothing else runs it.
HOOKED_TEST(HookInert, DISABLED_SecureBody) {
  ASSERT_NE(getauxval(AT_SECURE), 0u);
  hook_test::WindowFile file(64 * hook_test::MiB);
  const agnocast_heaphook_options options = hook_test::options_for(AGNOCAST_HEAPHOOK_SCOPE_ALL);
  EXPECT_EQ(hook_test::hook().attach(&file.window, &options), AGNOCAST_HEAPHOOK_SECURE);
  EXPECT_EQ(hook_test::hook().attach(&file.window, &options), AGNOCAST_HEAPHOOK_SECURE);
  hook_test::Scope scope;
  EXPECT_FALSE(hook_test::is_shared(hook_test::opaque(malloc(100))));
  EXPECT_EQ(hook_test::usage().window_count, 0u);
}

TEST(HookInert, SetuidProgramsStayWithLibc) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root to make a setuid program";
  Directory directory;
  const bool linked = hook_test::hook_is_linked();
  const std::string copy = directory.path + "/copy";
  std::filesystem::copy_file(linked ? "/proc/self/exe" : programs + "/hook_test_report", copy);
  chmod(copy.c_str(), 04755);
  RunOptions options;
  options.run_as_uid = 65534;
  options.preload = !linked;
  const Outcome probe = run({copy, "--help"}, options);
  if (probe.exit_status == 126 || probe.exit_status == 127) {
    GTEST_SKIP() << "another user cannot run programs of the build directory: " << probe.error;
  }
  if (linked) {
    const Outcome outcome =
        run({copy, "--in-own-process", "--gtest_filter=HookInert.DISABLED_SecureBody",
             "--gtest_also_run_disabled_tests", "--gtest_brief=1"},
            options);
    EXPECT_EQ(outcome.exit_status, 0) << outcome.output << outcome.error;
    EXPECT_NE(outcome.output.find("[  PASSED  ] 1 test"), std::string::npos) << outcome.output;
  } else {
    // The loader itself ignores such a preload.
    const Outcome outcome = run({copy}, options);
    EXPECT_NE(outcome.output.find("secure 1\n"), std::string::npos) << outcome.output;
    EXPECT_EQ(outcome.output.find("heaphook"), std::string::npos) << outcome.output;
  }
}

}  // namespace
