// SPDX-License-Identifier: Apache-2.0
//
// Processes for the process sweeps: a program that forks processes before it uses the library
// itself. The library is the twin with crash points. Each process connects to the test's socket,
// obeys its own control page, and answers each packet with one packet.
//
//   pub ID TOPIC QOS · sub ID TOPIC QOS · cb ID TOPIC QOS
//       QOS: depth, then t (transient local), a (keep-all). cb: a callback thread records messages
//   others ID TOPIC QOS           like sub, but ignores publishers of its own process: a message of
//                                 one of them is bad
//   publish ID COUNT · foreign ID COUNT · big ID COUNT   → how many were committed
//       foreign: outside the shared heap, so adopted. big: 4 MiB of addresses, mostly untouched
//   borrow ID · commit ID         a loan stays open; it is filled and published → as publish
//   later ID COUNT · done ID COUNT     12 MiB each, in a separate thread;
//                                 → ok when it waits for a window or is done, → as publish
//   take ID → none | PUBLISHER:NUMBER, held · drain ID → all, by batches, not held
//   heard ID → messages of the callback
//   asleep                        waits until the thread of the callbacks sleeps
//   release · drop → ok | nothing      the oldest held message; release checks it once more
//   orphaned → why the session is orphaned, once it is
//   connected · moved · settled   waits until the daemon knows this process; until all its
//                                 publishers have moved there; until no previous session is left
//   unpub ID · unsub ID           held messages stay
//   fork                          a child that lives as long as this process, with all it inherits
//   sync                          everything announced so far has been handled
//   quit                          ends like a program that returns from main

#include <base/sockets/packet_socket.hpp>
#include <tests/recovery/sweep_parcel.hpp>
#include <tests/support/crash/crash_point.hpp>
#include <tests/support/processes/actor.hpp>
#include <tests/support/processes/spun.hpp>

#include <fcntl.h>
#include <grp.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cstdlib>
#include <deque>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <sstream>
#include <string>
#include <thread>
#include <utility>

namespace agnocast::sweep {
namespace {

constexpr std::size_t big_words = (std::size_t{4} << 20) / sizeof(std::uint64_t);
constexpr std::size_t huge_words = big_words * 3;  // all of them are touched

using Message = ipc_shared_ptr<const Parcel>;

std::string report(const Parcel& parcel) { return parcel.intact() ? parcel.name() : "bad content"; }

class Actor {
 public:
  std::string execute(std::istringstream& line) {
    std::string what, topic, qos;
    std::uint64_t id = 0, count = 0;
    line >> what;
    if (what == "sync") return sync();
    if (what == "release") return release();
    if (what == "drop") return drop();
    if (what == "orphaned") return await_orphaned();
    if (what == "fork") return fork_child();
    if (what == "asleep") return await_asleep();
    if (what == "connected" || what == "moved" || what == "settled") return await_move(what);
    line >> id;
    if (what == "take") return take(id);
    if (what == "drain") return drain(id);
    if (what == "heard") return heard(id);
    if (what == "unpub") return publishers_.erase(id), "ok";
    if (what == "unsub") return subscriptions_.erase(id), callbacks_.erase(id), "ok";
    if (what == "borrow") return borrow(id);
    if (what == "later") return line >> count, publish_later(id, count);
    if (what == "done") return publishing_.join(), published_later_;
    if (what == "publish" || what == "foreign" || what == "big" || what == "commit") {
      line >> count;
      return publish(what, id, count);
    }
    line >> topic >> qos;
    if (what == "pub") {
      publishers_[id].publisher =
          create_publisher<Parcel>(node_, topic, test::qos_from_letters(qos));
      own_.insert(id);
    } else if (what == "sub") {
      subscriptions_[id] = create_subscription<Parcel>(node_, topic, test::qos_from_letters(qos));
    } else if (what == "others") {
      subscriptions_[id] =
          create_subscription<Parcel>(node_, topic, test::qos_from_letters(qos),
                                      SubscriptionOptions().ignore_local_publications());
      ignoring_.insert(id);
    } else if (what == "cb") {
      listen(id, topic, test::qos_from_letters(qos));
    } else {
      return "bad command " + what;
    }
    return "ok";
  }

 private:
  struct OwnPublisher {
    Publisher<Parcel>::SharedPtr publisher;
    std::uint64_t number = 0;
    ipc_shared_ptr<Parcel> loan = {};  // borrowed and not committed
  };
  struct Heard {
    std::mutex mutex;
    std::string names;
  };
  struct Callback {
    std::shared_ptr<Heard> heard;
    Subscription<Parcel>::SharedPtr subscription;
  };

  std::string publish(const std::string& how, std::uint64_t id, std::uint64_t count) {
    OwnPublisher& own = publishers_.at(id);
    std::uint64_t committed = 0;
    for (; committed < count; ++committed) {
      const std::uint64_t words = 40 + own.number % 7;
      PublishResult result;
      if (how == "foreign") {
        auto parcel = std::make_unique<Parcel>();
        parcel->fill(id, own.number + 1, words);
        result = own.publisher->publish(std::move(parcel));
      } else {
        auto loan = how == "commit" ? std::move(own.loan) : own.publisher->borrow_loaned_message();
        const bool is_huge = how == "huge";
        if (is_huge || how == "big") loan->words.reserve(is_huge ? huge_words : big_words);
        loan->fill(id, own.number + 1, is_huge ? huge_words : words);
        // A window may be under way; data built meanwhile lies outside the heap.
        for (int i = 0; i < 10'000; ++i) {
          result = own.publisher->publish(std::move(loan));
          if ((how != "big" && how != "huge") || result.code != Errc::heap_exhausted) break;
          waited_ = i;
          ::usleep(1000);
        }
      }
      if (!result) return std::to_string(committed) + " " + sentence_of(result.code);
      if (how != "big" && how != "huge" && (how == "foreign") != (result.adopted_bytes != 0))
        return "bad adoption";
      ++own.number;
    }
    return std::to_string(committed);
  }

  std::string publish_later(std::uint64_t id, std::uint64_t count) {
    waited_ = 0;
    is_through_ = false;
    publishing_ = std::thread([this, id, count] {
      published_later_ = publish("huge", id, count);
      is_through_ = true;
    });
    while (!is_through_ && waited_ < 50) ::usleep(1000);
    return "ok";
  }

  std::string borrow(std::uint64_t id) {
    OwnPublisher& own = publishers_.at(id);
    own.loan = own.publisher->borrow_loaned_message();
    own.loan->words.reserve(10);  // begun before, and not enough
    return "ok";
  }

  std::string take(std::uint64_t id) {
    Message message = subscriptions_.at(id)->take();
    if (!message) return "none";
    const std::string name = report_to(id, *message);
    held_.push_back(std::move(message));
    return name;
  }
  std::string drain(std::uint64_t id) {
    std::string names;
    std::array<Message, 3> batch;
    while (subscriptions_.at(id)->take_batch(batch.data(), batch.size()) != 0) {
      for (const Message& message : batch) {
        if (message) names += report_to(id, *message) + " ";
      }
    }
    return names;
  }
  std::string report_to(std::uint64_t subscription, const Parcel& parcel) const {
    if (ignoring_.contains(subscription) && own_.contains(parcel.publisher))
      return "bad: from its own process";
    return report(parcel);
  }
  std::string release() {
    if (held_.empty()) return "nothing";
    const bool intact = held_.front()->intact();
    held_.pop_front();
    return intact ? "ok" : "bad content";
  }

  std::string drop() {
    if (held_.empty()) return "nothing";
    held_.pop_front();
    return "ok";
  }

  static std::string await_orphaned() {
    for (int i = 0; i < 10'000 && orphan_reason() == Errc::ok; ++i) ::usleep(1000);
    return sentence_of(orphan_reason());
  }

  static std::string line_of(const std::filesystem::path& path) {
    std::ifstream file(path);
    std::string line;
    std::getline(file, line);
    return line;
  }
  static std::size_t count_threads(const char* name) {
    std::size_t count = 0;
    std::error_code gone;  // a thread may end during the check
    for (const auto& task : std::filesystem::directory_iterator("/proc/self/task", gone))
      count += line_of(task.path() / "comm") == name;
    return count;
  }

  /// It sleeps, and its sleep word says so, while it is in this system call: proc_pid_syscall(5).
  static bool is_in_epoll_wait(const std::filesystem::path& task) {
    const std::string call = line_of(task / "syscall").substr(0, 4);
#ifdef SYS_epoll_wait
    if (call.rfind(std::to_string(SYS_epoll_wait) + " ", 0) == 0) return true;
#endif
    return call.rfind(std::to_string(SYS_epoll_pwait) + " ", 0) == 0;
  }
  static std::string await_asleep() {
    for (int i = 0; i < 15'000; ++i, ::usleep(1000)) {
      std::error_code gone;
      for (const auto& task : std::filesystem::directory_iterator("/proc/self/task", gone)) {
        if (line_of(task.path() / "comm") == "agnocast-call" && is_in_epoll_wait(task.path()))
          return "ok";
      }
    }
    return "bad: the callbacks' thread does not sleep";
  }
  static std::string await_move(const std::string& how_far) {
    for (int i = 0; i < 15'000; ++i) {
      if (connection_state() == ConnectionState::connected &&
          (how_far == "connected" || count_threads("agnocast-move") == 0) &&
          (how_far != "settled" || count_threads("agnocast-ctl") == 1))
        return "ok";
      ::usleep(1000);
    }
    return "bad: it is not " + how_far + ", with " + std::to_string(count_threads("agnocast-ctl")) +
           " sessions";
  }

  void listen(std::uint64_t id, const std::string& topic, const QoS& qos) {
    auto heard = std::make_shared<Heard>();
    callbacks_[id] = {
        heard, create_subscription<Parcel>(node_, topic, qos, [heard](const Message& message) {
          const std::lock_guard lock(heard->mutex);
          heard->names += report(*message) + " ";
        })};
  }
  std::string heard(std::uint64_t id) {
    Heard& heard = *callbacks_.at(id).heard;
    const std::lock_guard lock(heard.mutex);
    return heard.names;
  }

  // The daemon's answers come in order with its announcements. It refuses this request.
  std::string sync() {
    const auto refused = try_create_subscription<Parcel>(node_, "/sync", QoS(1000));
    if (refused) return "bad sync";
    return refused.error().code == Errc::depth_refused ? "ok" : "bad " + text_of(refused.error());
  }

  static std::string fork_child() {
    const pid_t parent = ::getpid();
    if (::fork() == 0) {
      ::prctl(PR_SET_PDEATHSIG, SIGKILL);
      while (::getppid() == parent) ::pause();
      ::_exit(0);
    }
    return "ok";
  }

  test::Spun<test::ActorNode> node_{"actor"};
  std::map<std::uint64_t, OwnPublisher> publishers_;
  std::map<std::uint64_t, Subscription<Parcel>::SharedPtr> subscriptions_;
  std::map<std::uint64_t, Callback> callbacks_;
  std::set<std::uint64_t> own_, ignoring_;  // ids of all its publishers; of such subscriptions
  std::deque<Message> held_;
  std::thread publishing_;
  std::atomic<bool> is_through_{false};
  std::atomic<int> waited_{0};
  std::string published_later_;
};

// The control page applies from the first step on.
void obey(const std::string& control_path) {
  const int file = ::open(control_path.c_str(), O_RDWR | O_CLOEXEC);
  void* const page =
      ::mmap(nullptr, sizeof(crash_points::Control), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  if (page == MAP_FAILED) std::abort();
  ::close(file);
  crash_points::use(*static_cast<crash_points::Control*>(page));
}

/// uid 0: no change.
void become(uid_t uid) {
  if (uid == 0) return;
  if (::setgroups(0, nullptr) != 0 || ::setgid(uid) != 0 || ::setuid(uid) != 0) std::abort();
  // As for any process that has always belonged to this user.
  ::prctl(PR_SET_DUMPABLE, 1);
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);  // the kernel clears it when the user changes
}

/// Returns when the process shall end normally.
void serve(const std::string& socket_path, const std::string& control_path, uid_t uid) {
  const PacketSocket socket = PacketSocket::connect(socket_path).value();
  obey(control_path);
  become(uid);
  static Actor& actor = *new Actor;  // as in a program whose endpoints live in statics
  std::array<std::byte, 4096> buffer;
  for (;;) {
    const auto packet = socket.receive(buffer, Wait::yes);
    if (!packet || packet->kind != Packet::Kind::data) ::_exit(0);
    const std::string text(reinterpret_cast<const char*>(buffer.data()), packet->bytes);
    std::istringstream line(text);
    std::string answer;
    if (text == "quit") return;
    try {
      answer = actor.execute(line);
    } catch (const std::exception& error) {
      answer = std::string("bad ") + error.what();
    }
    answer += '\n';  // a packet is never empty
    (void)socket.send(std::as_bytes(std::span(answer.data(), answer.size())), {}, Wait::yes);
  }
}

}  // namespace
}  // namespace agnocast::sweep

// spawn SOCKET CONTROL UID → its pid
int main() {
  ::signal(SIGCHLD, SIG_IGN);  // the children are not waited for
  const pid_t maker = ::getpid();
  std::string what, socket_path, control_path;
  uid_t uid = 0;
  while (std::cin >> what >> socket_path >> control_path >> uid) {
    std::cout.flush();
    const pid_t pid = ::fork();
    if (pid == 0) {
      ::prctl(PR_SET_PDEATHSIG, SIGKILL);
      if (::getppid() != maker) return 1;
      agnocast::sweep::serve(socket_path, control_path, uid);
      return 0;
    }
    std::cout << pid << std::endl;
  }
  return 0;
}
