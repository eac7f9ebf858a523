// SPDX-License-Identifier: Apache-2.0
//
// Goal: idle memory of a shared heap goes back to the system after AGNOCAST_HEAP_IDLE_SECONDS,
// beside traffic as well; memory that the traffic uses stays, and with `never` all of it stays.
// Method: the real daemon and hook; the blocks of the heap's memfd, and the hook's count of
// returned memory. Each in a process of its own, because a process has one heap.

#include <agnocast/abi/heaphook.h>
#include <agnocast/agnocast.hpp>
#include <tests/support/messages/bulk.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/own_process.hpp>
#include <tests/support/processes/plain_node.hpp>

#include <gtest/gtest.h>

#include <sys/stat.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;
using test::Bulk;
using test::eventually;
using test::in_own_process;
using test::PlainNode;
using test::take_soon;

constexpr std::uint64_t MiB = 1 << 20;
constexpr std::uint64_t spike_bytes = 300 * MiB;

std::uint64_t resident_bytes() {
  std::uint64_t blocks = 0;
  std::set<ino_t> seen;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) {
    std::error_code gone;
    const std::string target = std::filesystem::read_symlink(entry.path(), gone).string();
    struct stat status {};
    if (target.rfind("/memfd:", 0) != 0 || ::stat(entry.path().c_str(), &status) != 0) continue;
    if (seen.insert(status.st_ino).second) blocks += static_cast<std::uint64_t>(status.st_blocks);
  }
  return blocks * 512;
}

agnocast_heaphook_usage usage() {
  agnocast_heaphook_usage now{};
  agnocast_heaphook()->usage(&now);
  return now;
}

bool has_thread(const std::string& name) {
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::string found;
    std::getline(std::ifstream(task.path() / "comm"), found);
    if (found == name) return true;
  }
  return false;
}

class HeapReturns : public testing::Test {
 protected:
  void SetUp() override { ::setenv("AGNOCAST_SOCKET", daemon_.socket_path().c_str(), 1); }

  static Publisher<Bulk>::SharedPtr publisher_with(const char* idle_seconds) {
    ::setenv("AGNOCAST_HEAP_IDLE_SECONDS", idle_seconds, 1);
    return create_publisher<Bulk>(PlainNode(), "bulk", QoS(1));
  }
  /// Lends much at once, and returns it.
  static void spike(Publisher<Bulk>& publisher, std::uint64_t bytes = spike_bytes) {
    constexpr std::uint64_t loan_bytes = 5 * MiB;
    std::vector<ipc_shared_ptr<Bulk>> loans;
    for (std::uint64_t sum = 0; sum < bytes; sum += loan_bytes) {
      loans.push_back(publisher.borrow_loaned_message());
      loans.back()->data.resize(loan_bytes);
    }
  }
  /// Returns whether all memory of a spike is there just after it. Also true where a busy machine
  /// took longer for that than the memory may be idle.
  static bool keeps_a_spike(Publisher<Bulk>& publisher, std::uint64_t before,
                            Clock::duration idle) {
    const std::uint64_t punches = usage().punch_count;
    const auto begin = Clock::now();
    spike(publisher);
    const bool keeps = resident_bytes() >= before + spike_bytes && usage().punch_count == punches;
    return keeps || Clock::now() - begin >= idle;
  }
  template <class Subscription>
  static void publish_one(Publisher<Bulk>& publisher, const Subscription& subscription) {
    auto loan = publisher.borrow_loaned_message();
    loan->data.resize(2 * MiB);
    ASSERT_TRUE(publisher.publish(std::move(loan)));
    ASSERT_TRUE(take_soon(subscription));
  }

  test::DaemonProcess daemon_;
};

TEST_F(HeapReturns, ASpike) {
  EXPECT_TRUE(in_own_process([] {
    const auto publisher = publisher_with("3");
    const std::uint64_t before = resident_bytes();
    EXPECT_TRUE(keeps_a_spike(*publisher, before, 3s)) << "not by a free";
    EXPECT_TRUE(eventually([&] { return resident_bytes() <= before + spike_bytes / 20; }));
    EXPECT_TRUE(has_thread("agnocast-purge"));
    EXPECT_TRUE(keeps_a_spike(*publisher, before, 3s));
    EXPECT_TRUE(eventually([&] { return resident_bytes() <= before + spike_bytes / 20; }))
        << "the next one as well";
    EXPECT_EQ(usage().internal_error_count, 0u);
  }));
}

TEST_F(HeapReturns, ASpikeBesideTrafficThatKeepsItsMemory) {
  EXPECT_TRUE(in_own_process([] {
    const auto publisher = publisher_with("3");
    const auto subscription = create_subscription<Bulk>(PlainNode(), "bulk", QoS(1));
    ASSERT_TRUE(eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
    for (int i = 0; i < 5; ++i) publish_one(*publisher, subscription);
    const std::uint64_t before = resident_bytes();
    spike(*publisher);
    const auto go_on = [&] {
      publish_one(*publisher, subscription);
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    };
    EXPECT_TRUE(eventually([&] {
      go_on();
      return resident_bytes() <= before + spike_bytes / 20;
    }));
    std::uint64_t returned = 0;
    EXPECT_TRUE(eventually([&] {
      const std::uint64_t before_that = std::exchange(returned, usage().punch_count);
      for (int i = 0; i < 10; ++i) go_on();
      return returned > 0 && returned == before_that;
    })) << "the purge has an end";
    // The traffic uses a few places in turn. On a busy machine it uses more of them for a moment;
    // those are idle afterwards, and returned.
    bool keeps = false;
    for (int i = 0; i < 2 && !keeps; ++i) {
      const std::uint64_t before_that = usage().punch_count;
      for (const auto end = Clock::now() + 8s; Clock::now() < end;) go_on();
      keeps = usage().punch_count == before_that;
    }
    EXPECT_TRUE(keeps) << "memory that the traffic frees and takes again";
  }));
}

TEST_F(HeapReturns, NoMemoryThatIsUsedRepeatedly) {
  EXPECT_TRUE(in_own_process([] {
    const auto publisher = publisher_with("4");
    // For more than twice that time. Begins again where a busy machine made a turn so long that
    // memory may have been idle; where it makes one each time, this proves nothing.
    constexpr auto long_turn = 2s;
    Clock::duration longest = long_turn;
    std::uint64_t returned = 0;
    for (int attempt = 0; attempt < 6 && longest >= long_turn; ++attempt) {
      if (attempt > 0) std::this_thread::sleep_for(1s);  // a purge that has begun ends
      returned = usage().punch_count;
      longest = {};
      auto last = Clock::now();
      for (const auto end = last + 9s; last < end && longest < long_turn;) {
        spike(*publisher, 20 * MiB);
        std::this_thread::sleep_for(300ms);
        const auto now = Clock::now();
        longest = std::max(longest, now - std::exchange(last, now));
      }
    }
    EXPECT_TRUE(usage().punch_count == returned || longest >= long_turn)
        << usage().punch_count - returned;
  }));
}

TEST_F(HeapReturns, NothingWithNever) {
  EXPECT_TRUE(in_own_process([] {
    const auto publisher = publisher_with("never");
    spike(*publisher);
    const std::uint64_t full = resident_bytes();
    std::this_thread::sleep_for(std::chrono::seconds(4));  // as long as ASpike needs
    EXPECT_EQ(resident_bytes(), full);
    EXPECT_EQ(usage().punch_count, 0u);
    EXPECT_FALSE(has_thread("agnocast-purge")) << "no thread watches";
  }));
}

TEST_F(HeapReturns, AnInvalidValueIsNamedAndTheNextTryMayUseAValidOne) {
  EXPECT_TRUE(in_own_process([] {
    for (const char* value : {"0", "-1", "1.5", "10s", " 10", "always", "1000001"}) {
      ::setenv("AGNOCAST_HEAP_IDLE_SECONDS", value, 1);
      const auto refused = try_create_publisher<Bulk>(PlainNode(), "bulk", QoS(1));
      ASSERT_FALSE(refused) << value;
      EXPECT_EQ(refused.error().code, Errc::invalid_argument);
      EXPECT_EQ(detail_of(refused.error()),
                "AGNOCAST_HEAP_IDLE_SECONDS is \"" + std::string(value) +
                    "\", which is neither a number of seconds from 1 to 1000000 nor never");
    }
    EXPECT_TRUE(try_create_subscription<Bulk>(PlainNode(), "bulk", QoS(1)))
        << "a process that only subscribes has no heap";
    ::setenv("AGNOCAST_HEAP_IDLE_SECONDS", "", 1);
    EXPECT_TRUE(try_create_publisher<Bulk>(PlainNode(), "bulk", QoS(1)));
  }));
}

}  // namespace
}  // namespace agnocast
