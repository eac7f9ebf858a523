// SPDX-License-Identifier: Apache-2.0
//
// Floors: the minimal cost of a way to notify, with nothing around it: no queue, no types, no
// daemon. The distance of a real system from them shows its own cost.
//
//   floor-futex          a word and a futex for each receiver, which is always woken, even if
//                        awake
//   floor-eventfd        an eventfd each, in an edge-triggered epoll set and never read
//   floor-polling        a cache line that the receivers poll; none is woken
//   floor-chain          as floor-polling, but this line has the place of a second one, and that
//                        the place of a third one, which has the place of the payload: the lines
//                        of a head, an entry and an object with a pointer
//   bound-kernel-module  the least for a kernel module with POSIX queues: the sender one cheap
//                        system call (for its ioctl) and a mq_send each; the receiver epoll_wait,
//                        mq_receive, and two cheap system calls
//   floor-memcpy         as floor-futex, after one memcpy of the payload: the least for every
//                        system that copies
//
// One buffer of shared memory has the payload; the loop is closed, so it is not read while it is
// written. In scratch:
//   published             the number of the last message
//   chain                 for floor-chain
//   futexes[receivers]    the futexes

#include <bench/system.hpp>

#include <fcntl.h>
#include <linux/futex.h>
#include <mqueue.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <stdexcept>
#include <string>

namespace agnocast::bench {
namespace {

std::runtime_error failure(const std::string& what) {
  return std::runtime_error("floor: " + what + ": " + std::strerror(errno));
}

struct alignas(64) Line {
  std::atomic<std::uint64_t> number;
};
struct alignas(64) Futex {
  std::atomic<std::uint32_t> word;
};

/// Common part of all floors: the buffer, whose descriptor is the first one, and the words.
class Ground {
 public:
  explicit Ground(const Carriage& carriage)
      : bytes_(carriage.bytes), receivers_(carriage.receivers) {
    if ((1 + chain_lines) * sizeof(Line) + receivers_ * sizeof(Futex) > carriage.scratch_bytes)
      throw std::runtime_error("floor: too many receivers");
    published_ = static_cast<Line*>(carriage.scratch);
    futexes_ = reinterpret_cast<Futex*>(published_ + 1 + chain_lines);
    // Allocates all pages: floors have no first touch.
    void* const buffer = ::mmap(nullptr, bytes_, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE,
                                carriage.descriptors.at(0), 0);
    if (buffer == MAP_FAILED) throw failure("payload");
    buffer_ = static_cast<std::byte*>(buffer);
  }
  ~Ground() { ::munmap(buffer_, bytes_); }
  Ground(const Ground&) = delete;
  Ground& operator=(const Ground&) = delete;

  std::byte* buffer() const noexcept { return buffer_; }
  std::size_t bytes() const noexcept { return bytes_; }
  std::size_t receivers() const noexcept { return receivers_; }
  std::atomic<std::uint64_t>& published() const noexcept { return published_->number; }
  static constexpr std::size_t chain_lines = 16;
  std::atomic<std::uint64_t>& chain(std::uint64_t line) const noexcept {
    return published_[1 + line % chain_lines].number;
  }
  std::atomic<std::uint32_t>& futex(std::size_t receiver) const noexcept {
    return futexes_[receiver].word;
  }
  void wake(std::size_t receiver) const noexcept {
    futex(receiver).fetch_add(1, std::memory_order_release);
    ::syscall(SYS_futex, &futex(receiver), FUTEX_WAKE, 1, nullptr, nullptr, 0);
  }

 private:
  std::size_t bytes_, receivers_;
  Line* published_ = nullptr;
  Futex* futexes_ = nullptr;
  std::byte* buffer_ = nullptr;
};

std::vector<int> make_buffer(const Carriage& carriage) {
  const int buffer = ::memfd_create("agnocast-bench-floor", MFD_CLOEXEC);
  if (buffer < 0 || ::ftruncate(buffer, static_cast<off_t>(carriage.bytes)) != 0)
    throw failure("payload");
  return {buffer};
}

// Makes one for each receiver, behind the buffer.
template <int (*make)()>
std::vector<int> make_each(const Carriage& carriage) {
  std::vector<int> all = make_buffer(carriage);
  for (std::size_t i = 0; i < carriage.receivers; ++i) {
    all.push_back(make());
    if (all.back() < 0) throw failure("descriptor of a receiver");
  }
  return all;
}

int make_eventfd() { return ::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC); }

int make_queue() {
  static unsigned count = 0;
  const std::string name =
      "/agnocast-bench-" + std::to_string(::getpid()) + "-" + std::to_string(++count);
  mq_attr attributes{};
  attributes.mq_maxmsg = 10;
  attributes.mq_msgsize = sizeof(std::uint64_t);
  const int queue =
      ::mq_open(name.c_str(), O_RDWR | O_CREAT | O_EXCL | O_NONBLOCK, 0600, &attributes);
  ::mq_unlink(name.c_str());
  return queue;
}

// A system call that does nothing: the minimal cost of any other.
void enter_kernel() noexcept { ::syscall(SYS_getppid); }

// --- senders: each makes the message visible and rings

class FloorSender : public Sender {
 public:
  explicit FloorSender(const Carriage& carriage) : ground_(carriage), carriage_(carriage) {}
  bool is_matched() override { return true; }
  std::byte* prepare() override { return ground_.buffer(); }
  bool send() override {
    ground_.published().fetch_add(1, std::memory_order_release);
    for (std::size_t i = 0; i < ground_.receivers(); ++i) ring(i);
    return true;
  }

 protected:
  virtual void ring(std::size_t receiver) = 0;
  int descriptor(std::size_t receiver) const { return carriage_.descriptors[1 + receiver]; }
  Ground ground_;

 private:
  Carriage carriage_;
};

class FutexSender : public FloorSender {
 public:
  using FloorSender::FloorSender;

 protected:
  void ring(std::size_t receiver) override { ground_.wake(receiver); }
};

class CopySender : public FutexSender {
 public:
  explicit CopySender(const Carriage& carriage)
      : FutexSender(carriage), own_(carriage.bytes, std::byte{1}) {}
  std::byte* prepare() override { return own_.data(); }
  bool send() override {
    std::memcpy(ground_.buffer(), own_.data(), own_.size());
    return FutexSender::send();
  }

 private:
  std::vector<std::byte> own_;
};

class EventSender final : public FloorSender {
 public:
  using FloorSender::FloorSender;

 protected:
  void ring(std::size_t receiver) override {
    const std::uint64_t one = 1;
    (void)!::write(descriptor(receiver), &one, sizeof one);
  }
};

class PollingSender : public FloorSender {
 public:
  using FloorSender::FloorSender;

 protected:
  void ring(std::size_t) override {}
};

// The entries of a queue and the objects alternate in the lines of the chain. The object is made
// with the payload, before it is sent.
class ChainSender final : public PollingSender {
 public:
  using PollingSender::PollingSender;
  std::byte* prepare() override {
    // The payload's place in the buffer.
    ground_.chain(object()).store(0, std::memory_order_relaxed);
    return PollingSender::prepare();
  }
  bool send() override {
    ground_.chain(object() - 1).store(object(), std::memory_order_relaxed);
    return PollingSender::send();
  }

 private:
  std::uint64_t object() const noexcept {
    return 2 * (ground_.published().load(std::memory_order_relaxed) + 1) + 1;
  }
};

class ModuleSender final : public FloorSender {
 public:
  using FloorSender::FloorSender;
  bool send() override {
    enter_kernel();
    return FloorSender::send();
  }

 protected:
  void ring(std::size_t receiver) override {
    const std::uint64_t number = ground_.published().load(std::memory_order_relaxed);
    (void)::mq_send(descriptor(receiver), reinterpret_cast<const char*>(&number), sizeof number, 0);
  }
};

// --- receivers

class FloorReceiver : public Receiver {
 public:
  explicit FloorReceiver(const Carriage& carriage) : ground_(carriage), index_(carriage.index) {}
  void run(const OnMessage& on_message) override {
    std::uint64_t delivered = 0;
    while (!is_stopped_.load(std::memory_order_relaxed)) {
      const std::uint64_t published = ground_.published().load(std::memory_order_acquire);
      if (published == delivered) {
        wait();
        continue;
      }
      on_message(payload(published), ground_.bytes());
      ++delivered;
    }
  }
  void stop() override { is_stopped_.store(true); }

 protected:
  /// Returns the newest message; the loop is closed, so it is the next one.
  virtual const std::byte* payload(std::uint64_t) const { return ground_.buffer(); }
  /// Waits until rung, or for a while.
  virtual void wait() = 0;
  Ground ground_;
  std::size_t index_;
  std::atomic<bool> is_stopped_{false};
};

class PollingReceiver : public FloorReceiver {
 public:
  using FloorReceiver::FloorReceiver;

 protected:
  void wait() override {}
};

class ChainReceiver final : public PollingReceiver {
 public:
  using PollingReceiver::PollingReceiver;

 protected:
  const std::byte* payload(std::uint64_t number) const override {
    const std::uint64_t object = ground_.chain(2 * number).load(std::memory_order_relaxed);
    return ground_.buffer() + ground_.chain(object).load(std::memory_order_relaxed);
  }
};

class FutexReceiver final : public FloorReceiver {
 public:
  using FloorReceiver::FloorReceiver;
  void stop() override {
    FloorReceiver::stop();
    ground_.wake(index_);
  }

 protected:
  void wait() override {
    std::atomic<std::uint32_t>& futex = ground_.futex(index_);
    while (futex.load(std::memory_order_acquire) == heard_)
      ::syscall(SYS_futex, &futex, FUTEX_WAIT, heard_, nullptr, nullptr, 0);
    heard_ = futex.load(std::memory_order_acquire);
  }

 private:
  std::uint32_t heard_ = 0;
};

/// Sleeps in epoll_wait until its descriptor, or the eventfd of stop(), is readable.
class EpollReceiver : public FloorReceiver {
 public:
  EpollReceiver(const Carriage& carriage, std::uint32_t events)
      : FloorReceiver(carriage),
        descriptor_(carriage.descriptors.at(1 + carriage.index)),
        epoll_(::epoll_create1(EPOLL_CLOEXEC)),
        stop_(::eventfd(0, EFD_CLOEXEC)) {
    epoll_event event{};
    event.events = events;
    epoll_event stop_event{};
    stop_event.events = EPOLLIN;
    if (::epoll_ctl(epoll_, EPOLL_CTL_ADD, descriptor_, &event) != 0 ||
        ::epoll_ctl(epoll_, EPOLL_CTL_ADD, stop_, &stop_event) != 0)
      throw failure("epoll");
  }
  ~EpollReceiver() override {
    ::close(epoll_);
    ::close(stop_);
  }
  void stop() override {
    FloorReceiver::stop();
    const std::uint64_t one = 1;
    (void)!::write(stop_, &one, sizeof one);
  }

 protected:
  void wait() override {
    epoll_event event{};
    (void)::epoll_wait(epoll_, &event, 1, -1);
  }
  int descriptor_;

 private:
  int epoll_, stop_;
};

class EventReceiver final : public EpollReceiver {
 public:
  explicit EventReceiver(const Carriage& carriage) : EpollReceiver(carriage, EPOLLIN | EPOLLET) {}
};

class ModuleReceiver final : public EpollReceiver {
 public:
  explicit ModuleReceiver(const Carriage& carriage) : EpollReceiver(carriage, EPOLLIN) {}

 protected:
  void wait() override {
    EpollReceiver::wait();
    std::uint64_t number = 0;
    (void)::mq_receive(descriptor_, reinterpret_cast<char*>(&number), sizeof number, nullptr);
    enter_kernel();  // which message?
    enter_kernel();  // and whether there are more
  }
};

template <class Made, class Side>
std::unique_ptr<Side> make(const Carriage& carriage) {
  return std::make_unique<Made>(carriage);
}

template <class Sends, class Receives>
System system(std::string_view name, std::string_view summary,
              std::vector<int> (*descriptors)(const Carriage&), bool is_spinning = false) {
  return {.name = name,
          .summary = summary,
          .make_sender = make<Sends, Sender>,
          .make_receiver = make<Receives, Receiver>,
          .service = {},
          .environment = nullptr,
          .is_spinning = is_spinning,
          .descriptors = descriptors};
}

}  // namespace

std::vector<System> floor_systems() {
  return {
      system<FutexSender, FutexReceiver>("floor-futex", "a bare futex wake for each receiver",
                                         make_buffer),
      system<EventSender, EventReceiver>("floor-eventfd", "a bare eventfd each, edge-triggered",
                                         make_each<make_eventfd>),
      system<PollingSender, PollingReceiver>("floor-polling", "a cache line, looked at for ever",
                                             make_buffer, true),
      system<ChainSender, ChainReceiver>(
          "floor-chain", "three cache lines, each of which tells where the next one is",
          make_buffer, true),
      system<ModuleSender, ModuleReceiver>(
          "bound-kernel-module", "the system calls that a kernel module cannot do without",
          make_each<make_queue>),
      system<CopySender, FutexReceiver>("floor-memcpy", "one memcpy, then a bare futex wake",
                                        make_buffer),
  };
}

}  // namespace agnocast::bench
