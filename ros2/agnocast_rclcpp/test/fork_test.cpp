// SPDX-License-Identifier: Apache-2.0
//
// Goal: a node process may fork, exec and close what a child has inherited: the child gets errors
// for forbidden calls and can do no harm, the parent goes on undisturbed. A program that closes
// descriptors of others keeps its callbacks, its files and its end.
// Method: children of the test itself, while an executor spins in another thread. A child that
// hangs or crashes fails its case. What ends the process itself is in a process of its own (death
// tests).

#include "test_node.hpp"

#include <std_srvs/srv/trigger.hpp>

#include <gmock/gmock.h>

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <vector>

namespace agnocast_rclcpp {
namespace {

using namespace std::chrono_literals;
using Trigger = std_srvs::srv::Trigger;
using Message = agnocast::ipc_shared_ptr<const String>;

class ForkTest : public EveryExecutorTest {};
AGNOCAST_TEST_EXECUTORS(ForkTest);

/// Returns the exit status of a child that runs `body`, or minus the signal that ended it; failed
/// expectations are status 1.
template <class Body>
int run_in_child(Body body) {
  std::fflush(nullptr);
  const pid_t pid = ::fork();
  if (pid == 0) {
    ::alarm(30);
    body();
    std::fflush(nullptr);
    ::_exit(testing::Test::HasFailure() ? 1 : 0);
  }
  int status = 0;
  while (::waitpid(pid, &status, 0) < 0 && errno == EINTR) {
  }
  return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

/// A node with a subscription, spun by another thread, a service, and what publishes to it.
struct Busy {
  rclcpp::Node::SharedPtr node = std::make_shared<rclcpp::Node>("busy");
  std::atomic<int> heard{0}, published{0};
  agnocast::Subscription<String>::SharedPtr subscription = agnocast::create_subscription<String>(
      node, "topic", 1000, [this](const Message&) { ++heard; });
  agnocast::Publisher<String>::SharedPtr publisher =
      agnocast::create_publisher<String>(node, "topic", 1000);
  agnocast::Service<Trigger>::SharedPtr service = agnocast::create_service<Trigger>(
      node, "service",
      [](const agnocast::ipc_shared_ptr<const Trigger::Request>&,
         agnocast::ipc_shared_ptr<Trigger::Response>& response) { response->success = true; });
  agnocast::Client<Trigger>::SharedPtr client = agnocast::create_client<Trigger>(node, "service");
  std::unique_ptr<SpinningThread> spinning;

  explicit Busy(rclcpp::Executor& executor) {
    executor.add_node(node);
    spinning = std::make_unique<SpinningThread>(executor);
    EXPECT_TRUE(eventually([&] { return publisher->get_subscription_count() == 1; }));
    expect_unharmed();
  }
  void publish() {
    EXPECT_EQ(publisher->publish(String()).code, agnocast::Errc::ok);
    ++published;
  }
  void expect_unharmed() {
    for (int i = 0; i < 10; ++i) publish();
    EXPECT_TRUE(eventually([&] { return heard == published; })) << published << ", " << heard;
    ASSERT_TRUE(client->wait_for_service(30s));
    auto sent = client->async_send_request(client->borrow_loaned_request());
    ASSERT_EQ(sent.wait_for(30s), std::future_status::ready);
    EXPECT_TRUE(sent.get()->success);
  }
  void destroy_endpoints() {
    subscription.reset();
    publisher.reset();
    service.reset();
    client.reset();
  }
};

void expect_detached(Busy& busy) {
  const auto refused = [](auto&& make) {
    try {
      make();
    } catch (const agnocast::Error& error) {
      return error.code() == agnocast::Errc::shut_down;
    }
    return false;
  };
  EXPECT_TRUE(refused([&] { agnocast::create_publisher<String>(busy.node, "topic", 1); }));
  EXPECT_TRUE(refused([&] { agnocast::create_subscription<String>(busy.node, "topic", 1); }));
  EXPECT_TRUE(refused([&] {
    agnocast::create_subscription<String>(busy.node, "topic", 1, [](const Message&) {});
  }));
  EXPECT_EQ(busy.publisher->publish(String()).code, agnocast::Errc::shut_down);
}

TEST_P(ForkTest, AChildIsRefusedAndDisturbsNobody) {
  Busy busy(*executor_);
  EXPECT_EQ(run_in_child([&] {
              expect_detached(busy);
              EXPECT_EQ(run_in_child([&] { expect_detached(busy); }), 0) << "a grandchild";
              busy.destroy_endpoints();
            }),
            0);
  busy.expect_unharmed();
}

TEST_P(ForkTest, ChildrenDestroyEndpointsWhileMessagesFlow) {
  Busy busy(*executor_);
  std::atomic<bool> is_over{false};
  std::thread publishing([&] {
    while (!is_over) {
      busy.publish();
      std::this_thread::sleep_for(50us);
    }
  });
  for (int i = 0; i < 200 && !HasFailure(); ++i)
    EXPECT_EQ(run_in_child([&] { busy.destroy_endpoints(); }), 0) << "child " << i;
  is_over = true;
  publishing.join();
  busy.expect_unharmed();
}

TEST_P(ForkTest, ACallbackThatReturnsInAChildEndsItsSpinOnly) {
  Source source;
  const pid_t self = ::getpid();
  const auto node = std::make_shared<rclcpp::Node>("node");
  int heard = 0, status = -1;
  const auto subscription =
      agnocast::create_subscription<String>(node, "topic", 1000, [&](const Message&) {
        if (++heard != 2) return;
        const pid_t child = ::fork();
        if (child == 0) return (void)::alarm(30);
        ::waitpid(child, &status, 0);
      });
  executor_->add_node(node);
  source.publish(3);
  try {
    while (heard < 3) executor_->spin_once();
  } catch (const agnocast::Error& error) {
    if (::getpid() != self) ::_exit(error.code() == agnocast::Errc::shut_down ? 7 : 1);
    throw;
  }
  if (::getpid() != self) ::_exit(2);
  ASSERT_TRUE(WIFEXITED(status)) << status;
  EXPECT_EQ(WEXITSTATUS(status), 7);
}

// --- descriptors

/// An empty file, which this process or a child opens at the numbers that it has closed.
class File {
 public:
  File() { ::close(::mkstemp(path_.data())); }
  ~File() { ::unlink(path_.c_str()); }
  File(const File&) = delete;
  File& operator=(const File&) = delete;

  const std::string& path() const { return path_; }
  bool is_untouched() const { return std::filesystem::file_size(path_) == 0; }

 private:
  std::string path_ = "/tmp/agnocast-fork-XXXXXX";
};
void open_at(const std::vector<int>& numbers, const std::string& path) {
  for (const int number : numbers) {
    const int opened = ::open(path.c_str(), O_RDWR | O_CLOEXEC);
    if (opened == number) continue;
    ::dup2(opened, number);
    ::close(opened);
  }
}

/// Returns the descriptors whose /proc entry `is_wanted` accepts.
template <class Filter>
std::vector<int> open_descriptors(Filter is_wanted) {
  std::vector<int> found;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
    std::error_code ignored;
    const std::string target = std::filesystem::read_symlink(entry.path(), ignored);
    const int number = std::stoi(entry.path().filename());
    if (number > STDERR_FILENO && is_wanted(target)) found.push_back(number);
  }
  return found;
}

TEST_P(ForkTest, AChildMayCloseEverythingBeforeExec) {
  Busy busy(*executor_);
  for (int i = 0; i < 20; ++i) {
    EXPECT_EQ(run_in_child([] {
                ::close_range(STDERR_FILENO + 1, ~0U, 0);
                ::execl("/bin/true", "true", nullptr);
                ::_exit(127);
              }),
              0);
  }
  busy.expect_unharmed();
}

TEST_P(ForkTest, AChildThatClosedEverythingKeepsItsFiles) {
  Busy busy(*executor_);
  const File file;
  EXPECT_EQ(run_in_child([&] {
              const std::vector<int> numbers =
                  open_descriptors([](const std::string&) { return true; });
              ::close_range(STDERR_FILENO + 1, ~0U, 0);
              open_at(numbers, file.path());
              expect_detached(busy);
              busy.destroy_endpoints();
            }),
            0);
  EXPECT_TRUE(file.is_untouched());
  busy.expect_unharmed();
}

TEST_P(ForkTest, ProgramsInheritNoDescriptors) {
  Busy busy(*executor_);
  EXPECT_EQ(run_in_child([] {
              ::execl("/bin/sh", "sh", "-c",
                      "! ls -l /proc/self/fd /proc/$$/fd | grep -E 'memfd|anon_inode'", nullptr);
              ::_exit(127);
            }),
            0);
  busy.expect_unharmed();
}

constexpr int done = 7;

/// Closes what agnocast and its adapter have opened; DDS has sockets and pipes.
[[noreturn]] void close_and_exit(rclcpp::Executor& executor, const std::string& file) {
  ::alarm(60);
  Busy& busy = *new Busy(executor);  // exit() leaves rclcpp to itself
  const std::vector<int> numbers = open_descriptors(
      [](const std::string& target) { return target.rfind("anon_inode:", 0) == 0; });
  for (const int number : numbers) ::close(number);
  open_at(numbers, file);
  // Until the library has noticed, it may ring the doorbells.
  if (!eventually(
          [] { return agnocast::connection_state() == agnocast::ConnectionState::orphaned; }))
    std::_Exit(3);
  const int before = busy.heard;
  for (int i = 0; i < 10; ++i) {
    (void)busy.publisher->publish(String());
    std::this_thread::sleep_for(300ms);
  }
  if (!eventually([&] { return busy.heard == before + 10; })) std::_Exit(2);
  busy.spinning.reset();
  busy.destroy_endpoints();
  std::exit(done);
}

TEST_P(ForkTest, AProcessThatClosesOurDescriptorsKeepsCallbacksFilesAndItsEnd) {
  // The process of a death test begins this test again, with the environment of this one.
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  const File file;
  ::setenv("AGNOCAST_TEST_FILE", file.path().c_str(), 0);
  const std::string path = std::getenv("AGNOCAST_TEST_FILE");
  EXPECT_EXIT(close_and_exit(*executor_, path), testing::ExitedWithCode(done), "");
  ::unsetenv("AGNOCAST_TEST_FILE");
  EXPECT_TRUE(file.is_untouched());
}

}  // namespace
}  // namespace agnocast_rclcpp
