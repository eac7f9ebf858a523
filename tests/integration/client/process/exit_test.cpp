// SPDX-License-Identifier: Apache-2.0
//
// Goal: a process may call exit() at any time: no thread of the library runs user code that would
// touch destroyed objects, and exit() ends.
// Method: real processes that exit, with the real daemon. A static object gives the library every
// occasion while it is destroyed; late user code writes into a pipe that this process reads.

#include <agnocast/agnocast.hpp>
#include <tests/support/processes/child.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/spun.hpp>

#include <gmock/gmock.h>

#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <utility>

// exit() without destroying an executor leaves its thread unjoined, which is under test here.
extern "C" [[gnu::visibility("default")]] const char* __tsan_default_options();
extern "C" const char* __tsan_default_options() { return "report_thread_leaks=0"; }

namespace agnocast {
namespace {

using test::Child;
using test::PlainNode;
using test::Spun;
using test::take_soon;

int too_late = -1;  // the pipe
std::atomic<bool> is_destroyed{false};

/// The exiting thread itself may do anything.
void note(char what) {
  if (is_destroyed && ::gettid() != ::getpid()) (void)!::write(too_late, &what, 1);
}

struct Ping : SharedMessage {
  std::uint64_t number = 0;
  Ping() = default;
  Ping(const Ping&) = default;
  Ping& operator=(const Ping&) = default;
  ~Ping() { note('d'); }
};

/// One of the static objects; its destructor calls `act`.
struct AtExit {
  std::function<void()> act;
  ~AtExit() {
    is_destroyed = true;
    act();
  }
};

/// A woken thread needs less than the first; the control thread's timer less than the second.
constexpr std::chrono::milliseconds woken{500}, by_timer{2500};
void give_others_time(std::chrono::milliseconds time) { std::this_thread::sleep_for(time); }

class Exiting : public testing::Test {
 protected:
  void SetUp() override {
    ::setenv("AGNOCAST_SOCKET", daemon_.socket_path().c_str(), 1);
    ASSERT_EQ(::pipe(pipe_), 0);
    too_late = pipe_[1];
  }
  /// `body` uses the library and exits. Returns its status and the late writes.
  template <class Body>
  std::pair<int, std::string> run(Body body) {
    Child child([&]() noexcept -> int {
      ::alarm(60);
      static AtExit at_exit;  // before the first connection
      body(at_exit);
      return 9;
    });
    const int status = child.wait();
    ::close(pipe_[1]);
    std::string written(100, ' ');
    const ssize_t count = ::read(pipe_[0], written.data(), written.size());
    written.resize(count > 0 ? static_cast<std::size_t>(count) : 0);
    return {status, written};
  }
  std::pair<int, std::string> silent(int status) { return {status, ""}; }

  test::DaemonProcess daemon_;
  int pipe_[2] = {-1, -1};
};

}  // namespace

template <>
struct MessageTraits<Ping> {
  static constexpr const char* name = "tests/Ping";
};

namespace {

TEST_F(Exiting, NoCallbackBeginsAfterExit) {
  EXPECT_EQ(run([](AtExit& at_exit) {
              std::atomic<int> called{0};
              Spun<PlainNode> node;
              auto subscription = create_subscription<Ping>(node, "ping", QoS(10),
                                                            [&](const ipc_shared_ptr<const Ping>&) {
                                                              ++called;
                                                              note('c');
                                                            });
              auto publisher = create_publisher<Ping>(PlainNode(), "ping", 10);
              while (called == 0) {
                publisher->publish(publisher->borrow_loaned_message());
                std::this_thread::sleep_for(std::chrono::milliseconds(1));
              }
              at_exit.act = [&] {
                if (!publisher->publish(publisher->borrow_loaned_message())) ::_exit(3);
                give_others_time(woken);
              };
              std::exit(0);
            }),
            silent(0));
}

TEST_F(Exiting, NoEventCallbackBeginsAfterExit) {
  EXPECT_EQ(run([](AtExit& at_exit) {
              std::atomic<bool> matched{false};
              Spun<PlainNode> node;
              auto publisher = create_publisher<Ping>(
                  node, "ping", 10, PublisherOptions().matched_callback([&](MatchedInfo&) {
                    matched = true;
                    note('e');
                  }));
              auto subscription = create_subscription<Ping>(PlainNode(), "ping", QoS(10));
              while (!matched) std::this_thread::sleep_for(std::chrono::milliseconds(1));
              at_exit.act = [&] {
                subscription.reset();
                give_others_time(woken);
              };
              std::exit(0);
            }),
            silent(0));
}

TEST_F(Exiting, NoMessageIsDestroyedByTheControlThreadAfterExit) {
  EXPECT_EQ(run([](AtExit& at_exit) {
              auto subscription = create_subscription<Ping>(PlainNode(), "ping", QoS(10));
              auto publisher = create_publisher<Ping>(PlainNode(), "ping", 1);
              while (publisher->get_linked_subscription_count() == 0)
                std::this_thread::sleep_for(std::chrono::milliseconds(1));
              if (!publisher->publish(publisher->borrow_loaned_message())) ::_exit(3);
              auto held = take_soon(subscription);
              if (!publisher->publish(publisher->borrow_loaned_message())) ::_exit(3);
              at_exit.act = [&] {
                held.reset();  // the first one is no longer needed
                give_others_time(by_timer);
              };
              std::exit(0);
            }),
            silent(0));
}

TEST_F(Exiting, ARunningCallbackIsWaitedFor) {
  EXPECT_EQ(run([](AtExit& at_exit) {
              std::atomic<bool> is_inside{false}, has_ended{false};
              Spun<PlainNode> node;
              auto subscription = create_subscription<Ping>(
                  node, "ping", QoS(10), [&](const ipc_shared_ptr<const Ping>&) {
                    is_inside = true;
                    std::this_thread::sleep_for(std::chrono::milliseconds(200));
                    has_ended = true;
                  });
              auto publisher = create_publisher<Ping>(PlainNode(), "ping", 10);
              publisher->publish(publisher->borrow_loaned_message());
              while (!is_inside) {
                publisher->publish(publisher->borrow_loaned_message());
                std::this_thread::sleep_for(std::chrono::milliseconds(1));
              }
              at_exit.act = [&] {
                if (!has_ended) ::_exit(4);
              };
              std::exit(0);
            }),
            silent(0));
}

TEST_F(Exiting, ACallbackThatNeverEndsDoesNotBlockExit) {
  EXPECT_EQ(run([](AtExit& at_exit) {
              std::atomic<bool> is_inside{false};
              Spun<PlainNode> node;
              auto subscription = create_subscription<Ping>(node, "ping", QoS(10),
                                                            [&](const ipc_shared_ptr<const Ping>&) {
                                                              is_inside = true;
                                                              for (;;) ::pause();
                                                            });
              auto publisher = create_publisher<Ping>(PlainNode(), "ping", 10);
              while (!is_inside) {
                publisher->publish(publisher->borrow_loaned_message());
                std::this_thread::sleep_for(std::chrono::milliseconds(1));
              }
              at_exit.act = [] {};
              std::exit(0);
            }),
            silent(0));
}

TEST_F(Exiting, ACallbackMayExit) {
  EXPECT_EQ(run([](AtExit& at_exit) {
              at_exit.act = [] {};
              Spun<PlainNode> node;
              auto subscription = create_subscription<Ping>(
                  node, "ping", QoS(10), [](const ipc_shared_ptr<const Ping>&) { std::exit(7); });
              auto publisher = create_publisher<Ping>(PlainNode(), "ping", 10);
              for (;;) {
                publisher->publish(publisher->borrow_loaned_message());
                std::this_thread::sleep_for(std::chrono::milliseconds(1));
              }
            }),
            silent(7));
}

TEST_F(Exiting, NothingIsCreatedAfterExit) {
  EXPECT_EQ(run([](AtExit& at_exit) {
              auto publisher = create_publisher<Ping>(PlainNode(), "ping", 1);
              at_exit.act = [] {
                const auto another = try_create_publisher<Ping>(PlainNode(), "ping", QoS(1));
                if (another || another.error().code != Errc::shut_down) ::_exit(3);
                const auto subscription = try_create_subscription<Ping>(
                    PlainNode(), "ping", QoS(1), [](const ipc_shared_ptr<const Ping>&) {});
                if (subscription || subscription.error().code != Errc::shut_down) ::_exit(4);
              };
              std::exit(0);
            }),
            silent(0));
}

}  // namespace
}  // namespace agnocast
