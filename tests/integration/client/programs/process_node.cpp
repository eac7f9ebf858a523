// SPDX-License-Identifier: Apache-2.0
//
// A node that does to its own process what its argument says, and reports on standard output, line
// by line. Ends by SIGALRM after a minute, unless its signals are blocked.
//
//   signals PLACE      PLACE is user code that the library runs: callback event request response
//                      destructor closure. Prints the signals blocked there, in a thread and in a
//                      child started there. The endpoints' creator has only SIGUSR1 blocked
//   raise              a callback raises SIGTERM
//   asleep             prints which threads of the library do not block SIGTERM while they sleep
//   main_ends WHAT     main calls pthread_exit() while endpoints live. WHAT else runs: nothing
//                      worker callback busy
//   callback_ends PLACE  user code calls pthread_exit(): callback event request response; prints
//                      whether the next one runs
//   callback_cancelled   the same by pthread_cancel() while the thread sleeps
//   endless WHERE      main returns while a callback runs for ever; its executor and subscription
//                      are static objects, the subscription's made before or after the first
//                      endpoint: before after
//   mutual             two callbacks destroy each other's subscription
//   closes WHERE       closes every descriptor and opens files: at the numbers that are then free
//                      (low), or at each number that was open before (same). Prints the state of
//                      the endpoints and whether the library has touched the files
//   closes forked      the same (at each number), and forks: in the child these numbers are the
//                      program's. The child destroys its endpoints and checks the files
//   relative DIRECTORY  connects by a relative path from there, changes its directory, and
//                      reconnects after the daemon was restarted
//   begins FROM TO     nobody listens at TO when it first connects; right after the first refusal,
//                      FROM is renamed to TO. Without FROM nobody ever listens

#include <tests/integration/services/services.hpp>
#include <tests/support/processes/spun.hpp>

#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace {

std::function<void()> when_refused;  // called at the first refused connection
std::atomic<int> refusals{0};

}  // namespace

/// The library's calls come here as well.
extern "C" [[gnu::visibility("default")]] int connect(int fd, const sockaddr* address,
                                                      socklen_t bytes) {
  const long status = ::syscall(SYS_connect, fd, address, bytes);
  if (status == 0) return 0;
  const int error = errno;
  if (++refusals == 1 && when_refused) when_refused();
  errno = error;
  return -1;
}

namespace {

/// Runs `act` in its destructor; for destructors of closures.
struct AtEnd {
  std::function<void()> act;
  explicit AtEnd(std::function<void()> what) : act(std::move(what)) {}
  AtEnd(AtEnd&&) = default;
  ~AtEnd() {
    if (act) act();
  }
};

std::function<void()> when_destroyed;  // of a message in a thread of the library's

struct Ping : agnocast::SharedMessage {
  std::uint64_t number = 0;
  Ping() = default;
  Ping(const Ping&) = default;
  Ping& operator=(const Ping&) = default;
  ~Ping();
};
thread_local bool is_own_thread = false;
Ping::~Ping() {
  if (!is_own_thread && when_destroyed) std::exchange(when_destroyed, nullptr)();
}

}  // namespace

template <>
struct agnocast::MessageTraits<Ping> {
  static constexpr const char* name = "tests/Ping";
};

namespace {

using agnocast::Node;
using agnocast::QoS;
using agnocast::test::Repeat;
using agnocast::test::Spun;
using Message = agnocast::ipc_shared_ptr<const Ping>;
using namespace std::chrono_literals;

void tell(const std::string& line) {
  const std::string text = line + "\n";
  (void)!::write(STDOUT_FILENO, text.data(), text.size());
}

std::string of_status(const std::filesystem::path& status, const std::string& key) {
  std::ifstream file(status);
  for (std::string line; std::getline(file, line);) {
    if (line.rfind(key + ":\t", 0) == 0) return line.substr(key.size() + 2);
  }
  return "(nothing)";
}
std::string blocked_here() { return of_status("/proc/thread-self/status", "SigBlk"); }

/// Those of a process started from here.
std::string blocked_in_child() {
  int pipe_[2];
  if (::pipe(pipe_) != 0) return "(no pipe)";
  posix_spawn_file_actions_t actions;
  ::posix_spawn_file_actions_init(&actions);
  ::posix_spawn_file_actions_adddup2(&actions, pipe_[1], STDOUT_FILENO);
  char program[] = "/bin/grep", key[] = "SigBlk", file[] = "/proc/self/status";
  char* const argv[] = {program, key, file, nullptr};
  pid_t child = -1;
  const int status = ::posix_spawn(&child, program, &actions, nullptr, argv, environ);
  ::posix_spawn_file_actions_destroy(&actions);
  ::close(pipe_[1]);
  char text[64] = "";
  if (status == 0) (void)!::read(pipe_[0], text, sizeof text - 1);
  ::close(pipe_[0]);
  if (status == 0) ::waitpid(child, nullptr, 0);
  const std::string line = text;
  return line.size() > 8 ? line.substr(8, line.find('\n') - 8) : "(no child)";
}

void tell_blocked() {
  std::string in_thread;
  std::thread([&] { in_thread = blocked_here(); }).join();
  tell("here " + blocked_here() + " thread " + in_thread + " child " + blocked_in_child());
}

void block(int signal) {
  sigset_t set;
  ::sigemptyset(&set);
  ::sigaddset(&set, signal);
  ::pthread_sigmask(SIG_SETMASK, &set, nullptr);
}

template <class Condition>
void wait_until(Condition condition) {
  while (!condition()) std::this_thread::sleep_for(1ms);
}

/// One endpoint of each kind, so that all threads of the library exist.
struct Endpoints {
  /// The user code, by name of its place.
  std::map<std::string, std::function<void()>> places;
  std::atomic<int> calls{0};
  Spun<Node> first{"first"}, second{"second"};
  agnocast::Publisher<Ping>::SharedPtr publisher;
  agnocast::Subscription<Ping>::SharedPtr subscription;
  agnocast::Service<Repeat>::SharedPtr service;
  agnocast::Client<Repeat>::SharedPtr client;

  void run(const std::string& place) {
    ++calls;
    if (const auto found = places.find(place); found != places.end() && found->second)
      std::exchange(found->second, nullptr)();
  }
  void make() {
    const auto closure = std::make_shared<AtEnd>([this] { run("closure"); });
    publisher = first.create_publisher<Ping>("ping", QoS(1),
                                             agnocast::PublisherOptions().matched_callback(
                                                 [this](agnocast::MatchedInfo&) { run("event"); }));
    subscription = first.create_subscription<Ping>(
        "ping", QoS(10), [this, closure](const Message&) { run("callback"); });
    service = second.create_service<Repeat>(
        "repeat", [this](const agnocast::ipc_shared_ptr<const Repeat::Request>&,
                         agnocast::ipc_shared_ptr<Repeat::Response>&) { run("request"); });
    client = first.create_client<Repeat>("repeat");
  }
  void publish() { (void)publisher->publish(publisher->borrow_loaned_message()); }
  void ask() {
    (void)client->async_send_request(
        client->borrow_loaned_request(),
        [this](agnocast::Client<Repeat>::SharedFuture) { run("response"); });
  }
  /// Triggers all places.
  void use() {
    wait_until([this] { return publisher->get_linked_subscription_count() == 1; });
    (void)client->wait_for_service(20s);
    publish();
    ask();
  }
  /// Triggers this one again; another subscription is an event.
  void use(const std::string& place) {
    if (place == "callback") publish();
    if (place == "event") {
      (void)second.create_subscription<Ping>("ping", QoS(10), [](const Message&) {});
    }
    if (place == "request" || place == "response") ask();
  }
};

Endpoints& endpoints() {
  static Endpoints* const all = new Endpoints;  // exit() does not destroy them
  return *all;
}
/// With their executors: waits for the threads of these.
void destroy_endpoints() { delete &endpoints(); }

int signals(const std::string& place) {
  block(SIGUSR1);
  Endpoints& all = endpoints();
  std::atomic<bool> has_told{false};
  all.places[place] = [&] {
    tell_blocked();
    has_told = true;
  };
  all.make();
  if (place == "destructor") {
    // Held while it leaves the history, released while nobody publishes.
    auto holder = all.first.create_subscription<Ping>("ping", QoS(10));
    wait_until([&] { return all.publisher->get_linked_subscription_count() == 2; });
    is_own_thread = true;
    when_destroyed = all.places[place];
    all.publish();
    Message held;
    wait_until([&] { return static_cast<bool>(held = holder->take()); });
    all.publish();
    held.reset();
  } else if (place == "closure") {
    // The executor's thread ends the callback: it runs it during the destruction.
    std::atomic<bool> is_inside{false};
    all.places["callback"] = [&] {
      is_inside = true;
      all.subscription.reset();
    };
    all.use();
  } else {
    all.use();
  }
  wait_until([&] { return has_told.load(); });
  return 0;
}

int raises() {
  Endpoints& all = endpoints();
  all.places["callback"] = [] {
    (void)::raise(SIGTERM);
    tell("raised, and still here");
  };
  all.make();
  all.use();
  for (;;) ::pause();
}

int asleep() {
  Endpoints& all = endpoints();
  all.make();
  all.use();
  std::map<std::string, bool> blocks;
  // They sleep between two ticks: a thread that is awake at one look sleeps at another.
  for (int look = 0; look < 200; ++look) {
    for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
      std::string name;
      std::getline(std::ifstream(task.path() / "comm"), name);
      if (name.rfind("agnocast-", 0) != 0) continue;
      const auto mask =
          std::strtoull(of_status(task.path() / "status", "SigBlk").c_str(), nullptr, 16);
      bool& seen = blocks[name];
      seen = seen || (mask >> (SIGTERM - 1) & 1) != 0;
    }
    std::this_thread::sleep_for(10ms);
  }
  std::string line;
  for (const auto& [name, does] : blocks) line += name + (does ? " yes " : " no ");
  tell(line);
  return 0;
}

int main_ends(const std::string& what) {
  static std::atomic<bool> main_has_ended{false};
  std::atexit([] { tell("exit handlers, " + blocked_here()); });
  block(SIGUSR1);
  Endpoints& all = endpoints();
  all.make();
  all.use();
  wait_until([&] { return all.calls >= 4; });
  if (what == "worker") {
    std::thread([&] {
      wait_until([] { return main_has_ended.load(); });
      std::this_thread::sleep_for(3s);  // the library has looked
      const int before = all.calls;
      all.publish();
      wait_until([&] { return all.calls > before; });
      tell("the callbacks go on");
    }).detach();
  } else if (what == "callback") {
    std::atomic<bool> is_inside{false};
    all.places["callback"] = [&is_inside] {
      is_inside = true;
      std::this_thread::sleep_for(3s);
      tell("the callback has ended");
    };
    all.publish();
    wait_until([&] { return is_inside.load(); });
  } else if (what == "busy") {
    // The node publishes to itself, for ever.
    all.subscription = all.first.create_subscription<Ping>(
        "ping", QoS(10), [&all](const Message&) { all.publish(); });
    wait_until([&] { return all.publisher->get_linked_subscription_count() == 1; });
    all.publish();
  }
  tell("main ends");
  main_has_ended = true;
  ::pthread_exit(nullptr);
}

int callback_ends(const std::string& place) {
  Endpoints& all = endpoints();
  std::atomic<bool> ends{false};
  all.places[place] = [&] {
    ends = true;
    ::pthread_exit(nullptr);
  };
  all.make();
  all.use();
  wait_until([&] { return ends.load(); });
  std::atomic<bool> runs{false};
  all.places[place] = [&] { runs = true; };
  // The ending thread may have swallowed a call.
  while (!runs) {
    all.use(place);
    std::this_thread::sleep_for(10ms);
  }
  tell("the next one runs");
  destroy_endpoints();
  return 0;
}

int callback_cancelled() {
  Endpoints& all = endpoints();
  std::atomic<pthread_t> thread{};
  std::atomic<bool> runs{false};
  all.places["callback"] = [&] {
    thread = ::pthread_self();
    runs = true;
  };
  all.make();
  all.use();
  wait_until([&] { return runs.load(); });
  std::this_thread::sleep_for(20ms);
  ::pthread_cancel(thread.load());
  std::atomic<bool> other{false};
  while (!other) {
    all.places["callback"] = [&, before = thread.load()] {
      if (::pthread_equal(before, ::pthread_self()) == 0) other = true;
    };
    all.publish();
    std::this_thread::sleep_for(10ms);
  }
  tell("the next one runs");
  destroy_endpoints();
  return 0;
}

agnocast::Subscription<Ping>::SharedPtr made_before;

int endless(const std::string& where) {
  std::atomic<bool> is_inside{false};
  static Spun<Node> node("node");
  auto publisher = node.create_publisher<Ping>("ping", QoS(10));
  const auto subscribe = [&] {
    return node.create_subscription<Ping>("ping", QoS(10), [&](const Message&) {
      is_inside = true;
      for (;;) ::pause();
    });
  };
  if (where == "before") {
    made_before = subscribe();
  } else {
    static auto made_after = subscribe();
  }
  while (!is_inside) {
    (void)publisher->publish(publisher->borrow_loaned_message());
    std::this_thread::sleep_for(1ms);
  }
  tell("main returns");
  return 7;
}

int mutual() {
  Spun<Node> left("left"), right("right");
  agnocast::Subscription<Ping>::SharedPtr one, other;
  std::atomic<int> inside{0}, over{0};
  const auto destroys = [&](agnocast::Subscription<Ping>::SharedPtr& whom) {
    return [&](const Message&) {
      ++inside;
      wait_until([&] { return inside >= 2; });
      whom.reset();
      ++over;
    };
  };
  auto publisher = left.create_publisher<Ping>("ping", QoS(10));
  one = left.create_subscription<Ping>("ping", QoS(10), destroys(other));
  other = right.create_subscription<Ping>("ping", QoS(10), destroys(one));
  wait_until([&] { return publisher->get_linked_subscription_count() == 2; });
  (void)publisher->publish(publisher->borrow_loaned_message());
  wait_until([&] { return over == 2; });
  // Both nodes go on.
  std::atomic<int> heard{0};
  one = left.create_subscription<Ping>("ping", QoS(10), [&](const Message&) { ++heard; });
  other = right.create_subscription<Ping>("ping", QoS(10), [&](const Message&) { ++heard; });
  wait_until([&] { return publisher->get_linked_subscription_count() == 2; });
  (void)publisher->publish(publisher->borrow_loaned_message());
  wait_until([&] { return heard == 2; });
  tell("both are destroyed");
  return 0;
}

std::vector<int> open_numbers() {
  std::vector<int> all;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
    const int number = std::stoi(entry.path().filename());
    if (number > STDERR_FILENO) all.push_back(number);
  }
  return all;  // with the directory's descriptor, which is closed by now
}

/// Waits until all other threads have slept for 50 ms: nothing is left to do after a callback.
void wait_until_quiet() {
  const auto look = [] {
    std::string switches;
    for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
      if (task.path().filename() == std::to_string(::gettid())) continue;
      std::ifstream status(task.path() / "status");
      for (std::string line; std::getline(status, line);) {
        if (line.rfind("State:", 0) == 0 && line.find("S (sleeping)") == std::string::npos)
          return std::string();
        if (line.find("ctxt_switches") != std::string::npos) switches += line;
      }
    }
    return switches;
  };
  std::string before;
  wait_until([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    const std::string now = look();
    return !now.empty() && std::exchange(before, now) == now;
  });
}

/// A file of this process, which no one else uses.
struct OwnFile {
  explicit OwnFile(int at) {
    char path[] = "/tmp/agnocast-process-XXXXXX";
    number = ::mkstemp(path);
    ::unlink(path);
    if (at >= 0 && at != number) {
      ::dup2(number, at);
      ::close(number);
      number = at;
    }
    (void)!::write(number, "untouched", 9);
    ::fstat(number, &status);
  }
  bool is_untouched() const {
    struct stat now {};
    char text[16] = "";
    return ::fstat(number, &now) == 0 && now.st_ino == status.st_ino &&
           now.st_dev == status.st_dev && now.st_size == 9 &&
           ::pread(number, text, sizeof text, 0) == 9 && std::string(text, 9) == "untouched";
  }
  int number = -1;
  struct stat status {};
};

int closes(const std::string& where) {
  Endpoints& all = endpoints();
  all.make();
  all.use();
  wait_until([&] { return all.calls >= 4; });
  // A ring is not checked in the second before the library notices.
  wait_until_quiet();
  const std::vector<int> numbers = open_numbers();
  ::close_range(STDERR_FILENO + 1, ~0U, 0);
  std::vector<OwnFile> files;
  for (const int number : numbers) files.emplace_back(where == "low" ? -1 : number);
  if (where == "forked") {
    if (const pid_t child = ::fork(); child != 0) {
      int status = 0;
      ::waitpid(child, &status, 0);
      return WIFEXITED(status) ? WEXITSTATUS(status) : 1;
    }
  }
  const auto tell_files = [&] {
    int touched = 0;
    for (const OwnFile& file : files) touched += !file.is_untouched();
    tell(touched == 0 ? "files are untouched" : std::to_string(touched) + " files were touched");
  };
  if (where == "low") {
    for (int i = 0; i < 200; ++i) {
      all.publish();
      std::this_thread::sleep_for(1ms);
    }
  }
  if (where != "forked") {
    wait_until([] { return agnocast::connection_state() == agnocast::ConnectionState::orphaned; });
    tell(agnocast::word_of(agnocast::orphan_reason()));
    const int before = all.calls;
    while (all.calls < before + 3) {
      all.publish();
      std::this_thread::sleep_for(1ms);
    }
    tell("callbacks go on");
    const auto made = agnocast::try_create_subscription<Ping>(all.first, "ping", QoS(1));
    tell(made ? "a subscription was made" : agnocast::word_of(made.error().code));
  }
  destroy_endpoints();
  tell_files();
  return 0;
}

int relative(const std::string& directory) {
  if (::chdir(directory.c_str()) != 0) return 3;
  Endpoints& all = endpoints();
  all.make();
  if (::chdir("/") != 0) return 3;
  tell("connected");
  wait_until([] { return agnocast::connection_state() != agnocast::ConnectionState::connected; });
  wait_until([] { return agnocast::connection_state() == agnocast::ConnectionState::connected; });
  tell("connected again");
  return 0;
}

int begins(const std::string& from, const std::string& to) {
  if (!from.empty()) when_refused = [&] { (void)std::rename(from.c_str(), to.c_str()); };
  const auto made = agnocast::try_create_subscription<Ping>(Node("node"), "ping", QoS(1));
  tell(made ? "connected" : agnocast::word_of(made.error().code));
  tell(refusals < 2 ? std::to_string(refusals) + " refusals" : "more refusals");
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  ::alarm(60);
  const std::string what = argc > 1 ? argv[1] : "", how = argc > 2 ? argv[2] : "";
  if (what == "signals") return signals(how);
  if (what == "raise") return raises();
  if (what == "asleep") return asleep();
  if (what == "main_ends") return main_ends(how);
  if (what == "callback_ends") return callback_ends(how);
  if (what == "callback_cancelled") return callback_cancelled();
  if (what == "endless") return endless(how);
  if (what == "mutual") return mutual();
  if (what == "closes") return closes(how);
  if (what == "relative") return relative(how);
  if (what == "begins") return begins(how, argc > 3 ? argv[3] : "");
  return 2;
}
