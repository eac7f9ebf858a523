// SPDX-License-Identifier: Apache-2.0
//
// Roles "sender" and "receiver": the processes of a run. "sender-and-receiver" has both as threads
// of one process.
//
//   sender     makes its side, waits for the match and the start, then for each message: prepare
//              and mark (not measured), stamp, send, stamp, wait until every receiver has seen it
//   receiver   makes its side, and for each message: stamp, then verify the whole payload
//
// On one core a receiver preempts the sender, so it has a message before the publish call
// returns; that is intended: the comparison there excludes the interrupt from one core to the
// other.

#include <bench/role.hpp>

#include <bench/cpus.hpp>
#include <bench/process.hpp>

#include <fcntl.h>
#include <grp.h>
#include <sched.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <functional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>

namespace agnocast::bench {
namespace {

constexpr std::int64_t patience_ns = 10'000'000'000;
constexpr std::int64_t start_patience_ns = 3 * patience_ns;  // processes start and find each other

/// Returns the processor time of the whole process.
std::int64_t cpu_ns() noexcept {
  timespec time{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  return std::int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

void sleep_until(std::int64_t when_ns) noexcept {
  const timespec when{static_cast<time_t>(when_ns / 1'000'000'000), when_ns % 1'000'000'000};
  while (::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &when, nullptr) == EINTR) continue;
}

// Repeats `attempt` until it succeeds. Without a pause it only yields to processes on the same
// core.
template <class Attempt>
void insist(const std::string& what, std::int64_t pause_ns, Attempt attempt,
            std::int64_t at_most_ns = patience_ns) {
  const std::int64_t end_ns = now_ns() + at_most_ns;
  while (!attempt()) {
    const std::int64_t time_ns = now_ns();
    if (time_ns > end_ns) throw std::runtime_error(what);
    if (pause_ns > 0) {
      sleep_until(time_ns + pause_ns);
    } else {
      ::sched_yield();
    }
  }
}

// Without a period, the next message does not wait until a sleep ends.
std::int64_t nap_ns(const Plan& plan) noexcept { return plan.period_ns > 0 ? 50'000 : 0; }

void send_one(const Lane& lane, Sender& sender, std::uint64_t number) {
  const std::string name = "message " + std::to_string(number);
  std::byte* payload = nullptr;
  insist(name + " cannot be borrowed", nap_ns(lane.plan()),
         [&] { return (payload = sender.prepare()) != nullptr; });
  mark(payload, lane.plan().bytes, number);
  Lane::Sent& sent = lane.sent(number);
  sent.begin_ns = now_ns();  // once: a message that is refused first and sent later is late
  insist(name + " is not sent", nap_ns(lane.plan()), [&] {
    const bool is_sent = sender.send();
    sent.end_ns = now_ns();
    return is_sent;
  });
}

// Sleeps a period before it checks whether a message was seen, so as not to disturb it on its
// way; and continues until a slow message has been seen for a period too, so that the next one
// meets receivers equally at rest. Not with a period of 0.
void send_all(const Lane& lane, Sender& sender) {
  const std::int64_t period_ns = lane.plan().period_ns;
  std::int64_t cpu_before_ns = cpu_ns();
  for (std::uint64_t number = 1; number <= lane.plan().all_messages(); ++number) {
    if (number == lane.plan().warm_up + 1) cpu_before_ns = cpu_ns();
    send_one(lane, sender, number);
    if (period_ns > 0) sleep_until(lane.sent(number).end_ns + period_ns);
    insist("message " + std::to_string(number) + " was not seen by all receivers",
           nap_ns(lane.plan()), [&] {
             if (lane.head().has_error != 0) throw std::runtime_error("a receiver failed");
             return lane.have_all_seen(number);
           });
    if (period_ns > 0) sleep_until(lane.all_seen_ns() + period_ns);
  }
  lane.head().sender_cpu_ns = cpu_ns() - cpu_before_ns;
}

int be_sender(const std::vector<std::string>& arguments) {
  Lane lane(std::stoi(arguments.at(0)));
  try {
    const System& system = system_of(lane);
    take_place(lane, system, true);
    const auto sender = system.make_sender(carriage_of(lane, 0));
    lane.head().ready.fetch_add(1);
    insist(
        "no match between sender and receivers", 2'000'000,
        [&] { return lane.head().ready == 1 + lane.plan().receivers && sender->is_matched(); },
        start_patience_ns);
    lane.head().has_matched.store(1);
    lane.wait_while(Lane::waiting);
    send_all(lane, *sender);
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
    const System& system = system_of(lane);
    take_place(lane, system, false);
    become_receiver_user(lane);
    const auto receiver = system.make_receiver(carriage_of(lane, index));
    std::uint64_t expected = 1;
    std::thread stopper([&] {
      lane.wait_while(Lane::waiting);
      lane.wait_while(Lane::running);
      receiver->stop();
    });
    lane.head().ready.fetch_add(1);
    receiver->run([&](const std::byte* payload, std::size_t bytes) {
      const std::int64_t received_ns = now_ns();
      if (bytes != lane.plan().bytes || !is_intact(payload, bytes, expected)) {
        lane.set_error("message " + std::to_string(expected) + " came changed or out of turn");
        return;
      }
      lane.received_ns(index, expected) = received_ns;
      lane.seen(index).at_ns = now_ns();
      lane.seen(index).number.store(expected++, std::memory_order_release);
    });
    stopper.join();
    return lane.head().has_error == 0 ? 0 : 1;
  } catch (const std::exception& error) {
    lane.set_error(error.what());
    std::_Exit(1);  // the stopper may still wait
  }
}

int be_sender_and_receiver(const std::vector<std::string>& arguments) {
  // Each of them closes its descriptor.
  const int other = ::fcntl(std::stoi(arguments.at(0)), F_DUPFD_CLOEXEC, 0);
  if (other < 0) throw std::runtime_error(std::string("memory for a run: ") + std::strerror(errno));
  int received = 1;
  std::thread receiver([&] { received = be_receiver({std::to_string(other), "0"}); });
  const int sent = be_sender(arguments);
  receiver.join();
  return sent != 0 ? sent : received;
}

const RegisterRole sender_role("sender", be_sender);
const RegisterRole receiver_role("receiver", be_receiver);
const RegisterRole both_role("sender-and-receiver", be_sender_and_receiver);

}  // namespace

Carriage carriage_of(const Lane& lane, std::size_t index) {
  const Plan& plan = lane.plan();
  Carriage carriage{.topic = lane.head().topic,
                    .bytes = plan.bytes,
                    .receivers = plan.receivers,
                    .index = index,
                    .depth = plan.depth,
                    .scratch = lane.scratch(),
                    .scratch_bytes = Lane::scratch_bytes,
                    .descriptors = {}};
  const char* const inherited = std::getenv(descriptors_variable.data());
  std::istringstream numbers(inherited == nullptr ? "" : inherited);
  for (int descriptor = -1; numbers >> descriptor;) carriage.descriptors.push_back(descriptor);
  return carriage;
}

const System& system_of(const Lane& lane) {
  for (const System& system : systems()) {
    if (system.name == lane.head().system) return system;
  }
  throw std::runtime_error("no such system");
}

void take_place(const Lane& lane, const System& system, bool is_sender) {
  const Plan& plan = lane.plan();
  if (plan.cores == Cores::anywhere) return;
  if (!pin_to(is_sender || plan.cores == Cores::one ? cpus().first : cpus().second))
    throw std::runtime_error(std::string("pinning to a CPU: ") + std::strerror(errno));
  if (!plan.is_real_time || (!is_sender && system.is_spinning)) return;
  // A receiver has a higher priority than the sender, so that on one core nothing delays it.
  sched_param priority{};
  priority.sched_priority = is_sender ? 50 : 51;
  if (::sched_setscheduler(0, SCHED_FIFO, &priority) != 0) lane.head().is_without_fifo.store(1);
}

void become_receiver_user(const Lane& lane) {
  const uid_t uid = lane.plan().receiver_uid;
  if (uid == 0) return;
  if (::setgroups(0, nullptr) != 0 || ::setgid(uid) != 0 || ::setuid(uid) != 0)
    throw std::runtime_error(std::string("becoming another user: ") + std::strerror(errno));
  ::prctl(PR_SET_PDEATHSIG, SIGKILL);  // setuid has cleared it
}

}  // namespace agnocast::bench
