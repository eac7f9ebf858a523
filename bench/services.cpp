// SPDX-License-Identifier: Apache-2.0

#include <bench/environment.hpp>
#include <bench/services.hpp>

#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <mutex>
#include <set>
#include <sstream>
#include <stdexcept>
#include <thread>

namespace agnocast::bench {
namespace {

using Clock = std::chrono::steady_clock;
namespace fs = std::filesystem;
constexpr auto patience = std::chrono::seconds(10);

struct Part {
  std::string_view name;
  std::string_view from_bin;  // directory, if installed
  std::string_view built;     // in the build tree of this program
};
constexpr Part parts[] = {
    {"agnocastd", ".", AGNOCAST_BENCH_BUILT_DAEMON},
    {"agnocast-ctl", ".", AGNOCAST_BENCH_BUILT_CTL},
    {"agnocast-bridge", ".", AGNOCAST_BENCH_BUILT_BRIDGE},
    {"agnocast-bench-plot", ".", AGNOCAST_BENCH_BUILT_PLOT},
    {"libagnocast_heaphook.so", AGNOCAST_BENCH_LIB_FROM_BIN, AGNOCAST_BENCH_BUILT_HOOK},
};

std::string find_in_path(std::string_view program) {
  const char* const path = std::getenv("PATH");
  std::istringstream directories(path == nullptr ? "" : path);
  for (std::string directory; std::getline(directories, directory, ':');) {
    const std::string candidate = directory + "/" + std::string(program);
    if (::access(candidate.c_str(), X_OK) == 0) return candidate;
  }
  return {};
}

bool answers(const std::string& path) {
  const int socket = ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, path.c_str(), sizeof address.sun_path - 1);
  const bool is_there =
      ::connect(socket, reinterpret_cast<sockaddr*>(&address), sizeof address) == 0;
  ::close(socket);
  return is_there;
}

std::string content_of(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// Never destroyed: a signal may come while the process ends.
struct Directories {
  std::mutex mutex;
  std::set<std::string> paths;
};
Directories& directories() {
  static auto* const all = new Directories;
  return *all;
}

std::map<std::string_view, RegisterService::Start>& starts() {
  static std::map<std::string_view, RegisterService::Start> all;
  return all;
}

}  // namespace

std::string path_of(std::string_view name) {
  std::error_code ignored;
  const fs::path bin = fs::read_symlink("/proc/self/exe", ignored).parent_path();
  for (const Part& part : parts) {
    if (part.name != name) continue;
    const fs::path installed = bin / part.from_bin / name;
    if (fs::exists(installed, ignored)) return fs::weakly_canonical(installed, ignored);
    if (!part.built.empty() && fs::exists(part.built, ignored)) return std::string(part.built);
  }
  if (const std::string found = find_in_path(name); !found.empty()) return found;
  throw std::runtime_error(std::string(name) + " is neither beside agnocast-bench nor in PATH");
}

Directory::Directory() {
  const char* const root = std::getenv("TMPDIR");
  path_ = std::string(root != nullptr && *root != '\0' ? root : "/tmp") + "/agnocast-bench-XXXXXX";
  if (::mkdtemp(path_.data()) == nullptr || ::chmod(path_.c_str(), 0755) != 0)
    throw std::runtime_error(path_ + ": " + std::strerror(errno));
  const std::lock_guard lock(directories().mutex);
  directories().paths.insert(path_);
}

Directory::~Directory() {
  const std::lock_guard lock(directories().mutex);
  directories().paths.erase(path_);
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

void remove_directories() noexcept {
  const std::lock_guard lock(directories().mutex);
  std::error_code ignored;
  for (const std::string& path : directories().paths) fs::remove_all(path, ignored);
}

Daemon::Daemon(std::string_view config) : socket_(directory_.path() + "/run/agnocastd.sock") {
  std::ofstream(directory_.path() + "/agnocastd.toml") << config;
  process_ = std::make_unique<Process>(
      Process::Options{.command = {path_of("agnocastd"), "--foreground", "--config",
                                   directory_.path() + "/agnocastd.toml", "--socket", socket_},
                       .output = log_path(),
                       .end_signal = SIGTERM});
  const auto end = Clock::now() + patience;
  while (!answers(socket_)) {
    if (process_->status() || Clock::now() > end)
      throw std::runtime_error("agnocastd does not serve; it wrote:\n" + log());
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
}

std::string Daemon::log() const { return content_of(log_path()); }

std::vector<std::string> Services::variables(std::string_view service) {
  if (service.empty()) return {};
  if (service == "agnocastd") {
    if (daemon_ == nullptr) daemon_ = std::make_unique<Daemon>();
    return {daemon_->variable()};
  }
  if (others_.find(service) != others_.end()) return {};
  const auto start = starts().find(service);
  if (start == starts().end()) throw std::runtime_error("no such service: " + std::string(service));
  const std::string directory = directory_.path() + "/" + std::string(service);
  fs::create_directory(directory);
  others_.emplace(service, start->second(directory));
  return {};
}

bool Services::has(std::string_view service) {
  if (missing_.find(service) != missing_.end()) return false;
  try {
    (void)variables(service);
    return true;
  } catch (const std::runtime_error& error) {
    if (service == "agnocastd") throw;
    leave_out("systems that need " + std::string(service) + " are left out: " + error.what());
    missing_.emplace(service);
    return false;
  }
}

RegisterService::RegisterService(std::string_view name, Start start) {
  starts().emplace(name, start);
}

}  // namespace agnocast::bench
