// SPDX-License-Identifier: Apache-2.0
//
// Stage: one topic with real regions and two processes, for the crash sweeps.
//
// The parent is the daemon and one of the two sides; the other side is a forked child that
// executes commands one by one and may die at any crash point. Every process maps foreign memory
// read-only, so a store into it is a SIGSEGV and not silent corruption. Each run makes new
// regions.
#pragma once

#include <client/heap/peer_heap.hpp>
#include <dataplane/frontier.hpp>
#include <dataplane/publisher_core.hpp>
#include <dataplane/subscription_core.hpp>
#include <journal/board_steps.hpp>
#include <journal/queue_recovery.hpp>
#include <journal/verify.hpp>
#include <tests/support/crash/crash_point.hpp>

#include <base/memory/mapping.hpp>
#include <base/memory/memfd.hpp>

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/wait.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

namespace agnocast::sweep {

using M = SharedMemory;

inline constexpr std::uint64_t publisher_extent = abi::page_bytes;
inline constexpr std::uint64_t subscription_extent = abi::page_bytes;
inline constexpr std::uint64_t region_bytes = 1 << 20;
inline constexpr std::uint64_t heap_bytes = 4 << 20;
inline constexpr std::uint64_t growth_bytes = 256 << 10;
inline constexpr std::uint64_t slot_count = 64;
inline constexpr std::uint64_t armed_offset = offsetof(abi::ClientRegionHeader, wait_set);

/// A message that points to its data, like a std::vector.
struct Message {
  std::uint64_t number;
  std::uint64_t count;
  const std::uint64_t* data;
  std::uint64_t sum;
};
inline std::uint64_t element(std::uint64_t number, std::uint64_t i) {
  return (number + 1) * 0x9e3779b97f4a7c15 ^ i;
}
inline constexpr std::uint64_t elements_per_message = 700;  // 5.5 KB: crosses pages
inline constexpr std::uint64_t message_bytes = 8192;

/// Returns whether the bytes are exactly those that message `number` was built with.
inline bool intact(const Message& message, std::uint64_t number) {
  if (message.number != number || message.count != elements_per_message) return false;
  std::uint64_t sum = 0;
  for (std::uint64_t i = 0; i < message.count; ++i) {
    if (message.data[i] != element(number, i)) return false;
    sum += message.data[i];
  }
  return sum == message.sum;
}

struct Setup {
  abi::Qos offered;
  abi::Qos requested;
  std::uint64_t deferred_limit = 0;
};

class Stage {
 public:
  explicit Stage(const Setup& setup)
      : setup_(setup),
        board_fd_(make_memfd("board", abi::topic_bytes).value()),
        publisher_fd_(make_memfd("publisher", region_bytes).value()),
        subscriber_fd_(make_memfd("subscriber", region_bytes).value()),
        heap_fd_(make_memfd("heap", heap_bytes).value()),
        board_(
            Mapping::map(board_fd_.get(), abi::topic_bytes, Mapping::Access::read_write).value()),
        publisher_region_(
            Mapping::map(publisher_fd_.get(), region_bytes, Mapping::Access::read_write).value()),
        subscriber_region_(
            Mapping::map(subscriber_fd_.get(), region_bytes, Mapping::Access::read_write).value()) {
    // The window lies at addresses that are free now, in this process and thus in its children.
    // The lower end of a gap: the kernel puts further mappings at the upper end.
    constexpr std::uint64_t gap = std::uint64_t{1} << 30;
    heap_base_ =
        reinterpret_cast<std::uint64_t>(Mapping::reserve(0, heap_bytes + gap).value().base());
    words().head().store(abi::pack_entry(first_sequence(), 0), std::memory_order_relaxed);
    journal::BoardSteps<M>(topic()).add_publisher(0, publisher_generation,
                                                  {setup.offered, 0, publisher_extent, slot_count});
  }

  static constexpr std::uint64_t publisher_generation = 5;
  static std::uint64_t first_sequence() { return abi::first_sequence_of(publisher_generation); }

  region::TopicWords<M> topic() const { return {board_.base(), 0}; }
  region::PublisherWords<M> words() const { return {publisher_region_.base(), publisher_extent}; }
  region::LinkWords<M> line() const { return {subscriber_region_.base(), subscription_extent, 0}; }
  journal::BoardSteps<M> board_steps() const { return journal::BoardSteps<M>(topic()); }
  const Setup& setup() const { return setup_; }
  std::byte* publisher_region() const { return publisher_region_.base(); }
  std::byte* subscriber_region() const { return subscriber_region_.base(); }
  std::uint64_t heap_base() const { return heap_base_; }
  int heap_fd() const { return heap_fd_.get(); }

  dataplane::PublisherCore<M>::Identity publisher_identity() const {
    return {topic(),          words(),        0,          publisher_generation,
            first_sequence(), setup_.offered, slot_count, setup_.deferred_limit};
  }
  dataplane::LinkCore<M>::Identity link_identity() const {
    return {topic(),
            words(),
            line(),
            0,
            publisher_generation,
            first_sequence(),
            setup_.offered,
            setup_.requested,
            sizeof(Message),
            alignof(Message)};
  }

  /// The child may write only its own region; it sees the parent's side read-only.
  enum class Role : std::uint8_t { publisher, subscriber };
  void restrict_child(Role role) const {
    protect(board_);
    protect(role == Role::publisher ? subscriber_region_ : publisher_region_);
  }
  journal::Invariant verify(bool publisher_at_rest = true) const {
    const journal::Invariant queue =
        journal::verify_queue(words(), first_sequence(), slot_count, publisher_at_rest);
    if (queue != journal::Invariant::none) return queue;
    return journal::verify_link(line(), words(), publisher_generation, first_sequence(),
                                slot_count);
  }

 private:
  static void protect(const Mapping& mapping) {
    if (::mprotect(mapping.base(), mapping.bytes(), PROT_READ) != 0) std::abort();
  }

  Setup setup_;
  UniqueFd board_fd_, publisher_fd_, subscriber_fd_, heap_fd_;
  Mapping board_, publisher_region_, subscriber_region_;
  std::uint64_t heap_base_ = 0;
};

/// The publisher's process: queue and a heap that grows by frontier and poisons freed memory.
class PublisherSide {
 public:
  explicit PublisherSide(Stage& stage) : stage_(stage), core_(stage.publisher_identity()) {
    heap_ = Mapping::reserve(stage.heap_base(), heap_bytes).value();
    grow();
  }

  dataplane::PublishOutcome publish(bool with_growth) {
    if (with_growth) grow();
    const std::uint64_t address = allocate();
    const std::uint64_t number = core_.head_sequence() + 1 - Stage::first_sequence();
    auto* const message = reinterpret_cast<Message*>(address);
    auto* const data = reinterpret_cast<std::uint64_t*>(address + 1024);
    std::uint64_t sum = 0;
    for (std::uint64_t i = 0; i < elements_per_message; ++i) sum += data[i] = element(number, i);
    *message = {number, elements_per_message, data, sum};
    Environment environment{*this};
    const auto outcome = core_.publish({address, sizeof(Message), number}, environment);
    if (outcome != dataplane::PublishOutcome::published) free(address);
    return outcome;
  }
  void scan() {
    Environment environment{*this};
    core_.scan(environment);
  }
  void attach(std::uint64_t generation) {
    Environment environment{*this};
    core_.attach(0, generation, stage_.subscriber_region(), subscription_extent, armed_offset, 0,
                 environment);
    core_.scan(environment);
  }
  void detach(std::uint64_t generation) {
    core_.detach(0, generation);
    scan();
  }
  /// Withdraws the subscription; then its holds no longer count; then it is served as before.
  bool withdraw(std::uint64_t generation) {
    const bool withdrawn = core_.withdraw(0, generation, abi::Withdrawal::over_share);
    scan();
    return withdrawn;
  }
  void disregard(std::uint64_t generation) {
    core_.disregard(0, generation);
    scan();
  }
  bool serve_again(std::uint64_t generation) {
    Environment environment{*this};
    return core_.serve_again(0, generation, environment);
  }
  std::uint64_t allocated_count() const { return core_.allocated_count(); }
  std::uint64_t rings() const { return rings_; }

 private:
  struct Environment {
    PublisherSide& side;
    void ring(std::uint64_t, std::uint64_t) { ++side.rings_; }
    void freed(std::uint64_t, std::uint64_t address) { side.free(address); }
  };
  void grow() {
    const std::uint64_t bytes = std::min(frontier_ + growth_bytes, heap_bytes);
    std::byte* const at = heap_.base() + frontier_;
    if (::mmap(at, bytes - frontier_, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_FIXED,
               stage_.heap_fd(), static_cast<off_t>(frontier_)) == MAP_FAILED) {
      std::abort();
    }
    // The newest pages are used first, so that a reader with the old frontier faults.
    for (std::uint64_t offset = frontier_; offset < bytes; offset += message_bytes)
      blocks_.push_back(stage_.heap_base() + offset);
    frontier_ = bytes;
    dataplane::store_frontier<M>(stage_.publisher_region(), 0, frontier_);
  }
  std::uint64_t allocate() {
    if (blocks_.empty()) std::abort();
    const std::uint64_t block = blocks_.back();
    blocks_.pop_back();
    return block;
  }
  void free(std::uint64_t address) {
    std::memset(reinterpret_cast<void*>(address), 0xdd, message_bytes);
    blocks_.push_back(address);
  }

  Stage& stage_;
  dataplane::PublisherCore<M> core_;
  Mapping heap_;
  std::uint64_t frontier_ = 0;
  std::vector<std::uint64_t> blocks_;
  std::uint64_t rings_ = 0;
};

/// The subscriber's process. In the publisher's own process the heap is already mapped.
class SubscriberSide {
 public:
  explicit SubscriberSide(Stage& stage, bool in_publisher_process = false)
      : stage_(stage),
        in_publisher_process_(in_publisher_process),
        reservation_(),
        link_(stage.link_identity()),
        heap_(stage.publisher_region()),
        sleep_(stage.subscriber_region(), armed_offset) {
    if (in_publisher_process) return;
    reservation_ = Mapping::reserve(stage.heap_base(), heap_bytes).value();
    if (!heap_.add({0, stage.heap_base(), heap_bytes, 0},
                   reopen_read_only(stage.heap_fd()).value()))
      std::abort();
  }

  bool link(bool from_start) { return link_.link(from_start); }
  void unlink() { link_.unlink(); }
  void arm() { sleep_.arm(); }
  void disarm() { sleep_.disarm(); }
  void observe_publisher() { link_.observe_publisher(); }
  bool drained() const { return link_.drained(); }
  std::uint64_t lost() const { return link_.lost(); }
  std::uint64_t cursor() const { return link_.cursor(); }
  std::size_t held_count() const { return held_.size(); }

  enum class Found : std::uint8_t { nothing, intact, damaged };
  Found take(std::uint64_t* number = nullptr) {
    OwnHeap own{stage_.heap_base()};
    HeapLook windows(heap_, Unannounced::ignored);
    const auto taken = in_publisher_process_ ? link_.take(own) : link_.take(windows);
    if (!taken) return link_.malformed() == 0 ? Found::nothing : Found::damaged;
    held_.push_back(*taken);
    if (number != nullptr) *number = taken->sequence - Stage::first_sequence();
    return check(*taken) ? Found::intact : Found::damaged;
  }
  /// Releases the oldest held message. Returns whether it did not change while held.
  bool release() {
    if (held_.empty()) return true;
    const bool unchanged = check(held_.front());
    link_.release(held_.front().slot);
    held_.pop_front();
    return unchanged;
  }

 private:
  struct OwnHeap {
    std::uint64_t base;
    void open() const {}
    region::Place place_of(std::uint64_t address, std::uint64_t) const {
      return address - base < heap_bytes ? region::Place::readable : region::Place::outside;
    }
  };
  static bool check(const dataplane::Taken& taken) {
    return intact(*reinterpret_cast<const Message*>(taken.address),
                  taken.sequence - Stage::first_sequence());
  }

  Stage& stage_;
  bool in_publisher_process_;
  Mapping reservation_;
  dataplane::LinkCore<M> link_;
  PeerHeap heap_;
  dataplane::SleepCore<M> sleep_;
  std::deque<dataplane::Taken> held_;
};

/// A child that executes one-letter commands and answers each with a byte, or dies.
class Child {
 public:
  template <class Body>
  Child(std::uint64_t crash_at, Body body) {
    int pair[2];
    if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, pair) != 0) std::abort();
    pid_ = ::fork();
    if (pid_ == 0) {
      ::close(pair[0]);
      body(pair[1], crash_at);
      ::_exit(0);
    }
    ::close(pair[1]);
    socket_.reset(pair[0]);
  }
  ~Child() { end(); }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  pid_t pid() const { return pid_; }
  /// Kills it now.
  void end() {
    if (pid_ > 0) {
      ::kill(pid_, SIGKILL);
      ::waitpid(std::exchange(pid_, -1), nullptr, 0);
    }
  }

  /// Returns the answer, or nothing if the child died during the command.
  std::optional<char> command(char what) {
    char answer = 0;
    if (::send(socket_.get(), &what, 1, MSG_NOSIGNAL) != 1 ||
        ::recv(socket_.get(), &answer, 1, 0) != 1)
      return std::nullopt;
    return answer;
  }
  /// Waits for the end. Returns whether it was the SIGKILL of a crash point.
  bool was_killed() {
    int status = 0;
    ::waitpid(std::exchange(pid_, -1), &status, 0);
    return WIFSIGNALED(status) && WTERMSIG(status) == SIGKILL;
  }

 private:
  pid_t pid_ = -1;
  UniqueFd socket_;
};

/// Returns a child's answer to a command. It reports the child's failed expectations to the
/// parent.
inline char answer(bool done) { return testing::Test::HasFailure() ? '!' : done ? '+' : '-'; }

/// Serves commands in a child: `execute` gets each letter and returns the answer.
template <class Execute>
void serve(int socket, Execute execute) {
  char what = 0;
  while (::recv(socket, &what, 1, 0) == 1) {
    const char answer = execute(what);
    if (::send(socket, &answer, 1, MSG_NOSIGNAL) != 1) return;
  }
}

}  // namespace agnocast::sweep
