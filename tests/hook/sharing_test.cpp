// SPDX-License-Identifier: Apache-2.0
//
// Goal: the hook's purpose. A publisher builds a message of vectors and strings in a loan scope;
// another process maps the memfd read-only at the same address up to the frontier and follows the
// publisher's own pointers to equal content, also after growth and without a second window.
// Method: reader.c as the other process, steered through pipes.

#include "support.hpp"

#include <cinttypes>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

namespace {

using namespace hook_test;

struct Field {
  std::string name;
  std::uint32_t offset = 0;
  std::uint32_t count = 1;
};

struct PointCloud {
  std::uint32_t height = 1;
  std::uint32_t width = 0;
  std::string frame_id;
  std::vector<Field> fields;
  std::vector<std::uint8_t> data;
};

class Reader {
 public:
  explicit Reader(int read_fd) {
    int commands[2];
    int answers[2];
    if (pipe2(commands, O_CLOEXEC) != 0 || pipe2(answers, O_CLOEXEC) != 0) return;
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, commands[0], 0);
    posix_spawn_file_actions_adddup2(&actions, answers[1], 1);
    posix_spawn_file_actions_adddup2(&actions, read_fd, 3);
    std::string path = std::string(AGNOCAST_TEST_PROGRAMS) + "/hook_test_reader";
    char base[32];
    std::snprintf(base, sizeof base, "%" PRIxPTR, window_address);
    char* const arguments[] = {path.data(), base, nullptr};
    char* const environment[] = {nullptr};
    started_ = posix_spawn(&pid_, path.c_str(), &actions, nullptr, arguments, environment) == 0;
    posix_spawn_file_actions_destroy(&actions);
    close(commands[0]);
    close(answers[1]);
    commands_ = fdopen(commands[1], "w");
    answers_ = fdopen(answers[0], "r");
  }

  // Returns the reader's view of the address, given the frontier announced so far.
  std::string look_at(const PointCloud* message) {
    std::fprintf(commands_, "%" PRIu64 " %" PRIxPTR "\n",
                 announced.frontier[0].load(std::memory_order_acquire),
                 reinterpret_cast<std::uintptr_t>(message));
    std::fflush(commands_);
    char line[4096] = {};
    if (std::fgets(line, sizeof line, answers_) == nullptr) return "no answer";
    return line;
  }

  int finish() {
    std::fclose(commands_);
    std::fclose(answers_);
    return started_ ? hook_test::wait_for(pid_) : -1;
  }

 private:
  pid_t pid_ = -1;
  bool started_ = false;
  std::FILE* commands_ = nullptr;
  std::FILE* answers_ = nullptr;
};

std::string described(const PointCloud& message) {
  std::uint64_t sum = 1469598103934665603u;
  for (std::uint8_t byte : message.data) sum = (sum ^ byte) * 1099511628211u;
  std::string text =
      std::to_string(message.height) + " " + std::to_string(message.width) + " " + message.frame_id;
  for (const Field& field : message.fields)
    text += " " + field.name + ":" + std::to_string(field.offset);
  return text + " " + std::to_string(sum) + "\n";
}

PointCloud* make_cloud(std::size_t points, unsigned seed) {
  Scope scope;
  auto* const cloud = new PointCloud;
  cloud->width = static_cast<std::uint32_t>(points);
  cloud->frame_id = "a frame name that does not fit into the string object " + std::to_string(seed);
  for (const char* name : {"x", "y", "z", "intensity_of_the_returned_pulse"}) {
    cloud->fields.push_back(Field{name, static_cast<std::uint32_t>(cloud->fields.size() * 4)});
  }
  // Grown step by step, as drivers do.
  for (std::size_t i = 0; i < points * 16; ++i)
    cloud->data.push_back(static_cast<std::uint8_t>(i * 31 + seed));
  return cloud;
}

HOOKED_TEST(HookSharing, AnotherProcessReadsTheMessageThroughThePublishersPointers) {
  WindowFile file(1024 * MiB);
  attach(file);
  Reader reader(file.window.read_fd);
  const PointCloud* const cloud = make_cloud(30000, 1);
  EXPECT_EQ(reader.look_at(cloud), described(*cloud));
  delete cloud;
  EXPECT_EQ(reader.finish(), 0);
}

HOOKED_TEST(HookSharing, MessagesBeyondAGrownFrontierAreReadTheSameWay) {
  WindowFile file(1024 * MiB);
  attach(file);
  Reader reader(file.window.read_fd);
  std::vector<const PointCloud*> clouds;
  const std::uint64_t first_frontier = hook().frontier(0);
  for (unsigned i = 0; i < 20; ++i) {
    clouds.push_back(make_cloud(40000 + i * 5000, i));
    ASSERT_EQ(reader.look_at(clouds.back()), described(*clouds.back())) << i;
  }
  EXPECT_GT(hook().frontier(0), first_frontier);
  for (const PointCloud* cloud : clouds) EXPECT_EQ(reader.look_at(cloud), described(*cloud));
  for (const PointCloud* cloud : clouds) delete cloud;
  const PointCloud* const again = make_cloud(40000, 99);
  EXPECT_EQ(reader.look_at(again), described(*again))
      << "in memory that held other messages before";
  delete again;
  EXPECT_EQ(reader.finish(), 0);
}

HOOKED_TEST(HookSharing, TheReaderSeesAMessageThatOutlivesAPurge) {
  WindowFile file(1024 * MiB);
  attach(file);
  Reader reader(file.window.read_fd);
  const PointCloud* const kept = make_cloud(50000, 5);
  for (unsigned i = 0; i < 5; ++i) delete make_cloud(50000, i);
  hook().purge();
  EXPECT_EQ(reader.look_at(kept), described(*kept));
  delete kept;
  EXPECT_EQ(reader.finish(), 0);
}

}  // namespace
