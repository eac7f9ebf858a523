// SPDX-License-Identifier: Apache-2.0
//
// RouDi, the daemon of iceoryx, as a service of the benchmark. Its memory, lock and socket have names that hold for the
// whole host, so there can be one only: where another one runs, the systems that need it are left out. It is ended
// with SIGTERM, also when the benchmark dies, and then removes what is its own; what it leaves when it aborts meanwhile
// (as it does when clients died) is removed here, at its end and before its start.

#include <bench/services.hpp>

#include <fcntl.h>
#include <grp.h>
#include <sys/file.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <stdexcept>

namespace agnocast::bench {
namespace {

namespace fs = std::filesystem;

// A message takes the smallest chunk that it fits into, with some bytes for Cyclone DDS' header. All of it is written once
// by RouDi and then resident, about 0.3 GB, so there are few of the large ones: a keep-last depth of 10 on each side.
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

bool another_runs() {
  const int lock = ::open(lock_path, O_RDWR | O_CLOEXEC);
  if (lock < 0) return false;
  const bool is_held = ::flock(lock, LOCK_EX | LOCK_NB) != 0;
  ::close(lock);
  return is_held;
}

/// Sockets that clients which were killed have left: PREFIX, the pid, and whatever.
bool is_of_dead_client(const std::string& name) {
  for (const std::string prefix : {"agnocast-bench-iox-", "iceoryx_rt_"}) {
    if (name.rfind(prefix, 0) != 0) continue;
    const int pid = std::atoi(name.c_str() + prefix.size());
    return pid > 0 && ::kill(pid, 0) != 0;
  }
  return false;
}

void remove_leftovers() {
  if (another_runs()) return;
  std::error_code ignored;
  // The segment of messages is named for the group that may write to it.
  const group* const mine = ::getgrgid(::getegid());
  if (mine != nullptr) fs::remove(std::string("/dev/shm/") + mine->gr_name, ignored);
  for (const char* path : {"/dev/shm/iceoryx_mgmt", "/tmp/roudi", "/tmp/roudi.lock", lock_path})
    fs::remove(path, ignored);
  for (const fs::directory_entry& entry : fs::directory_iterator("/tmp", ignored)) {
    if (is_of_dead_client(entry.path().filename())) fs::remove(entry.path(), ignored);
  }
}

std::unique_ptr<Process> start(const std::string& directory) {
  if (another_runs())
    throw std::runtime_error(
        "iceoryx: another RouDi (iox-roudi) runs on this host, and there can be one only");
  remove_leftovers();  // of a benchmark that was killed
  const std::string file = directory + "/roudi.toml";
  std::ofstream(file) << configuration;
  // Monitoring is off as it costs wake-ups; --kill-delay: it waits for clients that do not end before it ends.
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
