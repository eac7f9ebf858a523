// SPDX-License-Identifier: Apache-2.0
//
// The processes of the case throughput. The sender writes every byte of every message, the
// receivers read every byte and count read messages in the lane. The sender keeps at most `depth`
// messages unread by the slowest receiver: so none loses any, whatever a system does with a full
// queue, and queues are alike in all systems.
//
//   warm-up, until all is read │ begin ─ messages back to back for Plan::lasting_ns ─ until all is read ─ end │ over
//
// The sender checks for unread messages only when it would exceed the number that it knows of.

#include <bench/cases/throughput.hpp>
#include <bench/process.hpp>
#include <bench/role.hpp>

#include <sched.h>
#include <time.h>

#include <algorithm>
#include <cstdlib>
#include <exception>
#include <stdexcept>
#include <string>
#include <thread>

namespace agnocast::bench::throughput {
namespace {

constexpr std::int64_t patience_ns = 10'000'000'000;
// Messages between two readings of the clock.
constexpr unsigned batch = 16;

std::size_t word_count(std::size_t bytes) { return bytes / sizeof(std::uint64_t); }

// Each word is the message's number.
void fill(std::byte* payload, std::size_t bytes, std::uint64_t number) noexcept {
  std::fill_n(reinterpret_cast<std::uint64_t*>(payload), word_count(bytes), number);
}
bool is_whole(const std::byte* payload, std::size_t bytes, std::uint64_t number) noexcept {
  const auto* const words = reinterpret_cast<const std::uint64_t*>(payload);
  std::uint64_t sum = 0;
  for (std::size_t i = 0; i < word_count(bytes); ++i) sum += words[i];
  return words[0] == number && sum == number * word_count(bytes);
}

// Repeats `attempt` until it succeeds: first at once, then after yielding this core.
template <class Attempt>
void insist(const Lane& lane, const char* what, Attempt attempt) {
  constexpr unsigned looks_at_once = 100;
  std::int64_t end_ns = 0;
  for (unsigned looks = 0; !attempt(); ++looks) {
    if (looks < looks_at_once) continue;
    if (looks == looks_at_once) end_ns = now_ns() + patience_ns;
    ::sched_yield();
    if (lane.head().has_error != 0) throw std::runtime_error("a receiver failed");
    if (looks % 64 == 0 && now_ns() > end_ns) throw std::runtime_error(what);
  }
}

class Pump {
 public:
  Pump(const Lane& lane, Sender& sender) noexcept : lane_(lane), sender_(sender) {}

  void send(std::uint64_t count) {
    for (; count > 0; --count) {
      ++number_;
      if (number_ > read_ + lane_.plan().depth) wait_until_read(number_ - lane_.plan().depth);
      std::byte* payload = nullptr;
      insist(lane_, "no message can be borrowed",
             [&] { return (payload = sender_.prepare()) != nullptr; });
      fill(payload, lane_.plan().bytes, number_);
      insist(lane_, "a message is not sent", [&] { return sender_.send(); });
    }
  }
  void drain() { wait_until_read(number_); }

 private:
  void wait_until_read(std::uint64_t number) {
    insist(lane_, "a message was not seen by all receivers", [&] {
      read_ = UINT64_MAX;
      for (std::size_t i = 0; i < lane_.plan().receivers; ++i)
        read_ = std::min(read_, lane_.seen(i).number.load(std::memory_order_acquire));
      return read_ >= number;
    });
  }

  const Lane& lane_;
  Sender& sender_;
  std::uint64_t number_ = 0;  // of the last one sent
  std::uint64_t read_ = 0;    // by all, at least
};

void wait_for_match(const Lane& lane, Sender& sender) {
  const std::int64_t end_ns = now_ns() + patience_ns;
  while (lane.head().ready != 1 + lane.plan().receivers || !sender.is_matched()) {
    if (now_ns() > end_ns) throw std::runtime_error("no match between sender and receivers");
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
}

int be_sender(const std::vector<std::string>& arguments) {
  Lane lane(std::stoi(arguments.at(0)));
  const Plan& plan = lane.plan();
  try {
    const System& system = find(lane.head().system);
    take_place(lane, system, true);
    const auto sender = system.make_sender(carriage_of(lane, 0));
    lane.head().ready.fetch_add(1);
    wait_for_match(lane, *sender);
    lane.set_state(Lane::running);
    Pump pump(lane, *sender);
    pump.send(plan.warm_up);
    pump.drain();
    Lane::Sent& span = lane.sent(1);
    span.begin_ns = now_ns();
    do {
      pump.send(plan.bytes > 4096 ? 1 : batch);
    } while (now_ns() < span.begin_ns + plan.lasting_ns);
    pump.drain();
    span.end_ns = now_ns();
    lane.set_state(Lane::over);
    return 0;
  } catch (const std::exception& error) {
    lane.set_error(error.what());
    lane.set_state(Lane::over);
    return 1;
  }
}

int be_receiver(const std::vector<std::string>& arguments) {
  Lane lane(std::stoi(arguments.at(0)));
  const std::size_t index = std::stoul(arguments.at(1));
  try {
    const System& system = find(lane.head().system);
    take_place(lane, system, false);
    const auto receiver = system.make_receiver(carriage_of(lane, index));
    std::thread stopper([&] {
      lane.wait_while(Lane::waiting);
      lane.wait_while(Lane::running);
      receiver->stop();
    });
    lane.head().ready.fetch_add(1);
    std::uint64_t expected = 1;
    receiver->run([&](const std::byte* payload, std::size_t bytes) {
      if (bytes != lane.plan().bytes || !is_whole(payload, bytes, expected)) {
        lane.set_error("message " + std::to_string(expected) +
                       " came changed or out of turn, or was lost");
        return;
      }
      lane.seen(index).number.store(expected++, std::memory_order_release);
    });
    stopper.join();
    return lane.head().has_error == 0 ? 0 : 1;
  } catch (const std::exception& error) {
    lane.set_error(error.what());
    std::_Exit(1);  // the stopper may still wait
  }
}

const RegisterRole sender(sender_role, be_sender);
const RegisterRole receiver(receiver_role, be_receiver);

}  // namespace
}  // namespace agnocast::bench::throughput
