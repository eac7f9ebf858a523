// SPDX-License-Identifier: Apache-2.0

#include <client/shares/machine_memory.hpp>
#include <tests/support/machine/temporary_directory.hpp>

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <string>

namespace agnocast {
namespace {

struct MachineMemory : testing::Test {
  void write(const std::string& path, const std::string& text) const {
    const std::filesystem::path file = directory.path() + path;
    std::filesystem::create_directories(file.parent_path());
    std::ofstream(file) << text;
  }
  std::uint64_t found() const { return machine_memory_bytes(directory.path().c_str()); }
  test::TemporaryDirectory directory;
  const std::uint64_t all = static_cast<std::uint64_t>(::sysconf(_SC_PHYS_PAGES)) *
                            static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE));
};

TEST_F(MachineMemory, IsTheMachinesMemoryWithoutACgroup) {
  EXPECT_EQ(found(), all);
  write("/proc/self/cgroup", "12:memory:/former\n");
  EXPECT_EQ(found(), all);
}

TEST_F(MachineMemory, IsTheSmallestLimitOfTheSurroundingCgroups) {
  write("/proc/self/cgroup", "1:name=systemd:/other\n0::/a/b\n");
  write("/sys/fs/cgroup/a/b/memory.max", "max\n");
  EXPECT_EQ(found(), all);
  write("/sys/fs/cgroup/a/memory.max", "2097152\n");
  EXPECT_EQ(found(), 2097152u);
  write("/sys/fs/cgroup/a/b/memory.max", "1048576\n");
  EXPECT_EQ(found(), 1048576u);
  write("/sys/fs/cgroup/other/memory.max", "4096\n");
  EXPECT_EQ(found(), 1048576u);
  write("/sys/fs/cgroup/memory.max", "524288\n");  // the root cgroup of a container
  EXPECT_EQ(found(), 524288u);
}

TEST_F(MachineMemory, IsTheLimitOfAContainersRootCgroup) {
  write("/proc/self/cgroup", "0::/\n");
  write("/sys/fs/cgroup/memory.max", "524288\n");
  EXPECT_EQ(found(), 524288u);
}

TEST_F(MachineMemory, IgnoresUnreadableLimits) {
  write("/proc/self/cgroup", "0::without a slash\n");
  write("/sys/fs/cgroup/memory.max", "many\n");
  EXPECT_EQ(found(), all);
  write("/proc/self/cgroup", "");
  EXPECT_EQ(found(), all);
}

}  // namespace
}  // namespace agnocast
