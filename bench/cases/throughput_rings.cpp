// SPDX-License-Identifier: Apache-2.0
//
// The floor of throughput: a ring of payloads in shared memory, and a counter of sent messages.
// The case's own back-pressure keeps the sender from overrunning receivers, so nothing else is
// needed. One floor polls the counter; the other sleeps on it as a futex, and the sender wakes
// the receivers that announced their sleep.

#include <bench/cases/throughput.hpp>

#include <linux/futex.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <climits>
#include <cstring>
#include <stdexcept>
#include <string>

namespace agnocast::bench::throughput {
namespace {

struct Words {
  alignas(64) std::atomic<std::uint32_t> sent;  // a futex
  alignas(64) std::atomic<std::uint32_t> waiters;
  alignas(64) std::atomic<std::uint32_t> ready;
};

/// Returns one more than may be unread: for the message in progress.
std::size_t slot_count(const Carriage& carriage) { return carriage.depth + 1; }

class Ring {
 public:
  explicit Ring(const Carriage& carriage)
      : slots_(slot_count(carriage)),
        bytes_(carriage.bytes),
        words_(*static_cast<Words*>(carriage.scratch)) {
    void* const base = ::mmap(nullptr, slots_ * bytes_, PROT_READ | PROT_WRITE,
                              MAP_SHARED | MAP_POPULATE, carriage.descriptors.at(0), 0);
    if (base == MAP_FAILED) throw std::runtime_error(std::string("ring: ") + std::strerror(errno));
    base_ = static_cast<std::byte*>(base);
  }
  ~Ring() { ::munmap(base_, slots_ * bytes_); }
  Ring(const Ring&) = delete;
  Ring& operator=(const Ring&) = delete;

  Words& words() const noexcept { return words_; }
  /// `number` counts from 0, and wraps as the counter does.
  std::byte* slot(std::uint64_t number) const noexcept { return base_ + number % slots_ * bytes_; }

 private:
  std::size_t slots_, bytes_;
  Words& words_;
  std::byte* base_ = nullptr;
};

template <bool sleeps>
class RingSender final : public Sender {
 public:
  explicit RingSender(const Carriage& carriage) : ring_(carriage), receivers_(carriage.receivers) {}
  bool is_matched() override { return ring_.words().ready == receivers_; }
  std::byte* prepare() override { return ring_.slot(sent_); }
  bool send() override {
    Words& words = ring_.words();
    if constexpr (sleeps) {
      // Sequentially consistent: either this sees the sleeping receiver, or that one sees the
      // message.
      words.sent.store(static_cast<std::uint32_t>(++sent_));
      if (words.waiters.load() != 0)
        ::syscall(SYS_futex, &words.sent, FUTEX_WAKE, INT_MAX, nullptr, nullptr, 0);
    } else {
      words.sent.store(static_cast<std::uint32_t>(++sent_), std::memory_order_release);
    }
    return true;
  }

 private:
  Ring ring_;
  std::size_t receivers_;
  std::uint64_t sent_ = 0;
};

template <bool sleeps>
class RingReceiver final : public Receiver {
 public:
  explicit RingReceiver(const Carriage& carriage) : ring_(carriage), bytes_(carriage.bytes) {}
  void run(const OnMessage& on_message) override {
    ring_.words().ready.fetch_add(1);
    for (std::uint64_t taken = 0; !is_stopped_.load(std::memory_order_relaxed);) {
      const std::uint32_t sent = ring_.words().sent.load(std::memory_order_acquire);
      if (sent == static_cast<std::uint32_t>(taken)) wait(sent);
      while (static_cast<std::uint32_t>(taken) != sent) on_message(ring_.slot(taken++), bytes_);
    }
  }
  void stop() override {
    // A receiver that is about to sleep misses this; its sleep has a time limit.
    is_stopped_ = true;
    ::syscall(SYS_futex, &ring_.words().sent, FUTEX_WAKE, INT_MAX, nullptr, nullptr, 0);
  }

 private:
  void wait(std::uint32_t sent) {
    if constexpr (sleeps) {
      constexpr timespec at_most{0, 100'000'000};
      Words& words = ring_.words();
      words.waiters.fetch_add(1);
      ::syscall(SYS_futex, &words.sent, FUTEX_WAIT, sent, &at_most, nullptr, 0);
      words.waiters.fetch_sub(1);
    }
  }

  Ring ring_;
  std::size_t bytes_;
  std::atomic<bool> is_stopped_{false};
};

std::vector<int> make_memory(const Carriage& carriage) {
  const int memory = ::memfd_create("agnocast-bench-ring", MFD_CLOEXEC);
  if (memory < 0 ||
      ::ftruncate(memory, static_cast<off_t>(slot_count(carriage) * carriage.bytes)) != 0)
    throw std::runtime_error(std::string("ring: ") + std::strerror(errno));
  return {memory};
}

template <bool sleeps>
System ring_system(std::string_view name, std::string_view summary) {
  return {.name = name,
          .summary = summary,
          .make_sender = [](const Carriage& carriage) -> std::unique_ptr<Sender> {
            return std::make_unique<RingSender<sleeps>>(carriage);
          },
          .make_receiver = [](const Carriage& carriage) -> std::unique_ptr<Receiver> {
            return std::make_unique<RingReceiver<sleeps>>(carriage);
          },
          .service = "",
          .environment = nullptr,
          .is_spinning = !sleeps,
          .descriptors = make_memory};
}

}  // namespace

std::vector<System> ring_systems() {
  return {ring_system<true>("floor-futex", "a ring; the receiver sleeps on a futex"),
          ring_system<false>("floor-polling", "a ring; the receiver never sleeps")};
}

}  // namespace agnocast::bench::throughput
