// SPDX-License-Identifier: Apache-2.0
//
// A node of a few lines that executes its arguments, one after the other, and ends as our programs
// do: status 0, or 1 with "program: what: why" and "hint: command". Public headers only.
//
//   uid=N memlock=BYTES addresses=BYTES lock                the process, before it connects
//   occupied=BYTES occupy=HEX                               maps as much (a page) there
//   depth=N topic=NAME type=text|wide|number                of the endpoints that follow
//   pub sub try_pub insist        keep an endpoint; try_: by its Result; insist: a try_pub that
//                                 may fail
//   publish=BYTES take=BYTES                                one message
//   full=BYTES                                            keep loans of BYTES until one is refused
//   foreign moved twice empty                               misuse of loans
//   fork                                                    with an open loan

#include <agnocast/agnocast.hpp>

#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace {

struct Text {
  std::string data;
};
struct Wide {  // the same name, another layout
  std::string data, more;
};
struct Number {
  std::uint64_t data = 0;
};

}  // namespace

template <>
struct agnocast::MessageTraits<Text> {
  static constexpr const char* name = "test/Text";
  static void for_each_pointer(const Text& text, PointerVisitor& visit) noexcept {
    visit("data", text.data);
  }
};
template <>
struct agnocast::MessageTraits<Wide> {
  static constexpr const char* name = "test/Text";
};
template <>
struct agnocast::MessageTraits<Number> {
  static constexpr const char* name = "test/Number";
};

namespace {

struct Node {
  const char* get_name() const { return "bad_input"; }
  const char* get_namespace() const { return "/ns"; }
  std::string get_fully_qualified_name() const { return "/ns/bad_input"; }
};

class Program {
 public:
  int run(const std::string& step) {
    const std::size_t equals = step.find('=');
    const std::string what = step.substr(0, equals);
    const std::string value = equals == std::string::npos ? "" : step.substr(equals + 1);
    if (what == "topic") return topic_ = value, 0;
    if (what == "occupied") return occupied_ = std::strtoull(value.c_str(), nullptr, 10), 0;
    if (what == "depth") return depth_ = std::strtoull(value.c_str(), nullptr, 10), 0;
    if (what == "type") return type_ = value, 0;
    if (what == "pub") return publishers_.push_back(publisher()), 0;
    if (what == "sub") return subscribe(), 0;
    if (what == "try_pub") return try_publisher();
    if (what == "insist") return static_cast<void>(try_publisher()), 0;
    if (what == "publish") return publish(std::strtoull(value.c_str(), nullptr, 10));
    if (what == "take") return take(std::strtoull(value.c_str(), nullptr, 10));
    if (what == "full") return fill_up(std::strtoull(value.c_str(), nullptr, 10));
    if (what == "fork") return fork_with_loan();
    const int misused = misuse(what);
    return misused >= 0 ? misused : prepare(what, value);
  }

 private:
  using Publisher = agnocast::Publisher<Text>::SharedPtr;

  static int tell(const char* what, agnocast::Errc code) {
    std::fprintf(stderr, "node: %s: %s\nhint: %s\n", what, agnocast::sentence_of(code),
                 agnocast::remedy_of(code));
    return 1;
  }
  static int told(const agnocast::PublishResult& result) {
    return result ? 0 : tell("publish", result.code);
  }

  int prepare(const std::string& what, const std::string& value) {
    const std::uint64_t number = std::strtoull(value.c_str(), nullptr, 0);
    const rlimit limit{number, number};
    const auto id = static_cast<uid_t>(number);
    int status = -1;
    if (what == "uid") status = ::setgid(id) != 0 ? -1 : ::setuid(id);
    if (what == "memlock") status = ::setrlimit(RLIMIT_MEMLOCK, &limit);
    if (what == "addresses") status = ::setrlimit(RLIMIT_AS, &limit);
    if (what == "lock") status = ::mlockall(MCL_FUTURE);
    if (what == "occupy") {
      void* const page = ::mmap(reinterpret_cast<void*>(number), occupied_, PROT_READ,
                                MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED_NOREPLACE, -1, 0);
      status = page == MAP_FAILED ? -1 : 0;
    }
    if (status != 0) std::perror(what.c_str());
    return status == 0 ? 0 : 3;
  }

  Publisher publisher() {
    const agnocast::QoS qos(depth_);
    if (type_ == "number") agnocast::create_publisher<Number>(node_, topic_, qos);
    if (type_ == "wide") agnocast::create_publisher<Wide>(node_, topic_, qos);
    return agnocast::create_publisher<Text>(node_, topic_, qos);
  }
  void subscribe() {
    subscriptions_.push_back(
        agnocast::create_subscription<Text>(node_, topic_, agnocast::QoS(depth_)));
  }
  int try_publisher() {
    auto made = agnocast::try_create_publisher<Text>(node_, topic_, agnocast::QoS(depth_));
    if (made) return 0;
    std::fprintf(stderr, "node: %s\nhint: %s\n", agnocast::text_of(made.error()).c_str(),
                 agnocast::remedy_of(made.error().code));
    return 1;
  }

  int publish(std::size_t bytes) {
    auto loan = publishers_.back()->borrow_loaned_message();
    loan->data.assign(bytes, 'x');
    const auto result = publishers_.back()->publish(std::move(loan));
    if (!result) return told(result);
    std::printf("published, %ju bytes adopted\n", std::uintmax_t{result.adopted_bytes});
    return 0;
  }

  int take(std::size_t bytes) {
    for (;;) {
      if (const auto message = subscriptions_.back()->take()) {
        std::printf("received %zu bytes\n", message->data.size());
        return message->data.size() == bytes ? 0 : 3;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  }

  // The control thread obtains windows as long as the daemon gives them.
  int fill_up(std::size_t bytes) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    std::vector<agnocast::ipc_shared_ptr<Text>> kept;
    while (std::chrono::steady_clock::now() < end) {
      kept.push_back(publishers_.back()->borrow_loaned_message());
      kept.back()->data.assign(bytes, 'x');
      auto probe = publishers_.back()->borrow_loaned_message();
      probe->data.assign(bytes, 'x');
      const auto result = publishers_.back()->publish(std::move(probe));
      // Another window may still be on its way.
      if (!result && result.code != agnocast::Errc::heap_exhausted) return told(result);
      if (!result) {
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
        kept.pop_back();
      }
    }
    return tell("publish", agnocast::Errc::heap_exhausted);
  }

  int misuse(const std::string& what) {
    if (what == "empty") {
      const Publisher there = publisher();
      return told(there->publish(agnocast::ipc_shared_ptr<Text>()));
    }
    if (what == "twice" || what == "moved") {
      const Publisher there = publisher();
      auto loan = there->borrow_loaned_message();
      const auto other = what == "twice" ? loan : agnocast::ipc_shared_ptr<Text>();
      there->publish(std::move(loan));
      auto again = what == "twice" ? other : std::move(loan);
      return told(there->publish(std::move(again)));
    }
    if (what == "foreign") {
      const Publisher lender = publisher(), other = publisher();
      auto loan = lender->borrow_loaned_message();
      return told(other->publish(std::move(loan)));
    }
    return -1;
  }

  int fork_with_loan() {
    auto loan = publishers_.back()->borrow_loaned_message();
    loan->data.assign(100, 'x');
    std::fflush(stdout);
    const pid_t child = ::fork();
    if (child == 0) {
      told(publishers_.back()->publish(std::move(loan)));
      loan.reset();
      const int status = try_publisher();
      std::fflush(stderr);
      ::_exit(status);
    }
    int status = 0;
    ::waitpid(child, &status, 0);
    if (WIFSIGNALED(status)) std::printf("the child died of signal %d\n", WTERMSIG(status));
    const auto result = publishers_.back()->publish(std::move(loan));
    std::printf("the parent's loan: %s\n", result ? "published" : "refused");
    return told(result);
  }

  Node node_;
  std::string topic_ = "/topic", type_ = "text";
  std::size_t depth_ = 1;
  std::size_t occupied_ = 4096;
  std::vector<Publisher> publishers_;
  std::vector<agnocast::Subscription<Text>::SharedPtr> subscriptions_;
};

}  // namespace

int main(int argc, char** argv) try {
  Program program;
  for (int i = 1; i < argc; ++i) {
    if (const int status = program.run(argv[i]); status != 0) return status;
  }
  return 0;
} catch (const agnocast::Error& error) {
  std::fprintf(stderr, "node: %s\nhint: %s\n", error.what(), error.remedy());
  return 1;
}
