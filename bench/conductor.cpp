// SPDX-License-Identifier: Apache-2.0

#include <bench/conductor.hpp>

#include <bench/role.hpp>

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <memory>
#include <stdexcept>
#include <string>
#include <thread>

namespace agnocast::bench {
namespace {

constexpr auto look_again = std::chrono::milliseconds(2);
constexpr std::chrono::seconds patience{30};  // for everything except the messages' own time

std::string new_topic() {
  static unsigned count = 0;
  return "/bench/p" + std::to_string(::getpid()) + "/run" + std::to_string(++count);
}

// Descriptors of a run, closed with it.
struct Descriptors {
  std::vector<int> all;
  ~Descriptors() {
    for (const int descriptor : all) ::close(descriptor);
  }
  std::string text() const {
    std::string text;
    for (const int descriptor : all) text += std::to_string(descriptor) + " ";
    return text;
  }
};

class Company {
 public:
  Company(const System& system, const Lane& lane, Services& services)
      : system_(system), lane_(lane), environment_(services.variables(system.service)) {
    if (system.environment != nullptr) {
      const auto more = system.environment();
      environment_.insert(environment_.end(), more.begin(), more.end());
    }
    if (system.descriptors != nullptr) descriptors_.all = system.descriptors(carriage_of(lane, 0));
    environment_.push_back(std::string(descriptors_variable) + "=" + descriptors_.text());
  }

  void start(std::string_view role, std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), std::to_string(lane_.descriptor()));
    std::vector<int> inherited = descriptors_.all;
    inherited.push_back(lane_.descriptor());
    std::vector<std::string> command = as_role(role, std::move(arguments));
    if (system_.program != nullptr) command.front() = system_.program();
    all_.emplace_back(Process::Options{.command = std::move(command),
                                       .environment = environment_,
                                       .descriptors = std::move(inherited)});
  }

  /// Waits for `condition`; throws if a process fails or reports an error.
  template <class Condition>
  void wait_for(const char* what, std::chrono::seconds at_most, Condition condition) {
    const auto end = std::chrono::steady_clock::now() + at_most;
    while (!condition()) {
      look_after();
      if (std::chrono::steady_clock::now() > end) fail(std::string(what) + " takes too long");
      std::this_thread::sleep_for(look_again);
    }
  }
  bool have_all_ended() {
    return std::all_of(all_.begin(), all_.end(), [](Process& one) { return one.status() == 0; });
  }
  bool has_first_ended() { return all_.front().status() == 0; }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw std::runtime_error(std::string(system_.name) + ": " + what);
  }
  void look_after() {
    for (Process& one : all_) {
      const auto status = one.status();
      if (!status || *status == 0) continue;
      const std::string error = lane_.error();
      fail(error.empty() ? "a process ended with status " + std::to_string(*status) : error);
    }
  }

  const System& system_;
  const Lane& lane_;
  std::vector<std::string> environment_;
  Descriptors descriptors_;
  std::vector<Process> all_;
};

void start_all(Company& company, const Plan& plan, std::string_view sender,
               std::string_view receiver) {
  company.start(sender, {});
  for (std::size_t i = 0; i < plan.receivers; ++i) company.start(receiver, {std::to_string(i)});
}

/// Returns the longest time of the messages.
std::chrono::seconds messages_of(const Plan& plan) {
  return std::chrono::duration_cast<std::chrono::seconds>(
      std::chrono::nanoseconds(2 * plan.period_ns + 100'000'000) * plan.all_messages());
}

}  // namespace

std::chrono::seconds longest_of(const Plan& plan) { return messages_of(plan) + 3 * patience; }

std::vector<double> Times::slowest_ns() const {
  std::vector<double> slowest = latency_ns.at(0);
  for (const auto& receiver : latency_ns) {
    for (std::size_t i = 0; i < slowest.size(); ++i) slowest[i] = std::max(slowest[i], receiver[i]);
  }
  return slowest;
}

Times conduct(const System& system, const Plan& plan, Services& services) {
  Lane lane(plan, system.name, new_topic());
  Company company(system, lane, services);
  if (system.is_one_process) {
    company.start("sender-and-receiver", {});
  } else {
    start_all(company, plan, "sender", "receiver");
  }
  const Lane::Head& head = lane.head();
  company.wait_for("starting and matching", patience,
                   [&] { return head.ready == 1 + plan.receivers && head.has_matched != 0; });
  lane.set_state(Lane::running);
  company.wait_for("the run", messages_of(plan) + patience,
                   [&] { return company.has_first_ended(); });
  company.wait_for("the end of the receivers", patience, [&] { return company.have_all_ended(); });

  Times times;
  times.is_without_fifo = head.is_without_fifo != 0;
  times.sender_cpu_ns =
      static_cast<double>(head.sender_cpu_ns) / static_cast<double>(plan.messages);
  times.latency_ns.resize(plan.receivers);
  for (std::uint64_t number = plan.warm_up + 1; number <= plan.all_messages(); ++number) {
    const Lane::Sent& sent = lane.sent(number);
    times.publish_ns.push_back(static_cast<double>(sent.end_ns - sent.begin_ns));
    for (std::size_t i = 0; i < plan.receivers; ++i)
      times.latency_ns[i].push_back(
          static_cast<double>(lane.received_ns(i, number) - sent.begin_ns));
  }
  return times;
}

void conduct_roles(const System& system, Lane& lane, Services& services, std::string_view sender,
                   std::string_view receiver) {
  Company company(system, lane, services);
  start_all(company, lane.plan(), sender, receiver);
  company.wait_for("the run", std::chrono::seconds(300), [&] { return company.have_all_ended(); });
}

}  // namespace agnocast::bench
