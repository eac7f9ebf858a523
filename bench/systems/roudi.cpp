// SPDX-License-Identifier: Apache-2.0
//
// RouDi, the daemon of iceoryx, as a service of the benchmark. The names of its memory, lock and
// socket are valid for the whole host, so there can be only one: if another one runs, the systems
// that need it are left out. It is ended with SIGTERM, also when the benchmark dies, and then
// removes its files; files that it leaves when it aborts (as it does when clients died) are
// removed here, at its end and before its start.

#include <bench/services.hpp>

#include <fcntl.h>
#include <grp.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace agnocast::bench {
namespace {

namespace fs = std::filesystem;

// A message takes the smallest chunk that it fits into, with some bytes for Cyclone DDS's header.
// RouDi writes all of it once, and it stays resident, about 0.3 GB, so there are few of the large
// ones: a keep-last depth of 10 on each side.
constexpr const char* configuration = R"([general]
version = 1

[[segment]]

[[segment.mempool]]
size = 256
count = 2048

[[segment.mempool]]
size = 4096
count = 1024

[[segment.mempool]]
size = 32768
count = 128

[[segment.mempool]]
size = 131072
count = 128

[[segment.mempool]]
size = 1114112
count = 32

[[segment.mempool]]
size = 8454144
count = 24
)";

constexpr const char* lock_path = "/tmp/iox-unique-roudi.lock";

/// Held, so that no RouDi can start meanwhile; unless one runs, or its lock must not be opened.
class RouDiLock {
 public:
  // O_CREAT must not open another user's file there (fs.protected_regular).
  RouDiLock() : file_(::open(lock_path, O_RDWR | O_CLOEXEC)) {
    if (file_ < 0) file_ = ::open(lock_path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    is_held_ = file_ >= 0 && ::flock(file_, LOCK_EX | LOCK_NB) == 0;
  }
  ~RouDiLock() {
    std::error_code ignored;
    if (is_held_) fs::remove(lock_path, ignored);
    if (file_ >= 0) ::close(file_);
  }
  RouDiLock(const RouDiLock&) = delete;
  RouDiLock& operator=(const RouDiLock&) = delete;
  bool is_held() const { return is_held_; }

 private:
  int file_;
  bool is_held_ = false;
};

bool is_of_this_user(const std::string& path) {
  struct stat file {};
  return ::lstat(path.c_str(), &file) == 0 && file.st_uid == ::geteuid();
}

/// Returns whether it is a socket of a killed client: PREFIX, the pid, and any suffix.
bool is_of_dead_client(const std::string& name) {
  for (const std::string prefix : {"agnocast-bench-iox-", "iceoryx_rt_"}) {
    if (name.rfind(prefix, 0) != 0) continue;
    const int pid = std::atoi(name.c_str() + prefix.size());
    return pid > 0 && ::kill(pid, 0) != 0;
  }
  return false;
}

/// Returns false if another RouDi runs.
bool remove_leftovers_unless_another_runs() {
  const RouDiLock lock;
  if (!lock.is_held()) return false;
  std::error_code ignored;
  const std::string management = "/dev/shm/iceoryx_mgmt";
  std::vector<std::string> leftovers = {"/tmp/roudi", "/tmp/roudi.lock"};
  // The segment of messages is named for the group that may write to it, and other programs may
  // use that name: it is RouDi's if the other segment is there too.
  const group* const mine = ::getgrgid(::getegid());
  if (mine != nullptr && is_of_this_user(management))
    leftovers.push_back(std::string("/dev/shm/") + mine->gr_name);
  leftovers.push_back(management);
  for (const std::string& path : leftovers) {
    if (is_of_this_user(path)) fs::remove(path, ignored);
  }
  for (const fs::directory_entry& entry : fs::directory_iterator("/tmp", ignored)) {
    if (is_of_dead_client(entry.path().filename())) fs::remove(entry.path(), ignored);
  }
  return true;
}
void remove_leftovers() { (void)remove_leftovers_unless_another_runs(); }

std::unique_ptr<Process> start(const std::string& directory) {
  // Leftovers belong to a benchmark that was killed.
  if (!remove_leftovers_unless_another_runs())
    throw std::runtime_error(
        "iceoryx: another RouDi (iox-roudi) runs on this host, and there can be one only");
  const std::string file = directory + "/roudi.toml";
  std::ofstream(file) << configuration;
  // Monitoring is off because it costs wake-ups; --kill-delay: it waits for clients that do not
  // end before it ends.
  auto roudi = std::make_unique<Process>(
      Process::Options{.command = {"iox-roudi", "--config-file", file, "--monitoring-mode", "off",
                                   "--log-level", "off", "--kill-delay", "2"},
                       .output = directory + "/log",
                       .has_pipes = true,
                       .end_signal = SIGTERM,
                       .at_end = remove_leftovers});
  try {
    while (roudi->line().find("ready for clients") == std::string::npos) continue;
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(
        std::string("iceoryx: RouDi (iox-roudi of Debian's package iceoryx) ") +
        "does not start: " + error.what());
  }
  return roudi;
}

const RegisterService roudi("iox-roudi", start);

}  // namespace
}  // namespace agnocast::bench
