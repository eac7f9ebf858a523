// SPDX-License-Identifier: Apache-2.0

#include <bench/cases/death_client.hpp>
#include <bench/process.hpp>

#include <agnocast/agnocast.hpp>

#include <time.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::bench {

Sample::~Sample() { destroyed_ns = now_ns(); }

void touch(const Sample& sample) noexcept {
  const volatile std::uint8_t* const bytes = sample.bytes.data();
  for (std::size_t i = 0; i < sample.bytes.size(); i += 4096) static_cast<void>(bytes[i]);
}

namespace {

void say_ready() {
  std::puts("ready");
  std::fflush(stdout);
}
[[noreturn]] void wait_for_death() {
  for (;;) ::pause();
}

[[noreturn]] void be_publisher(const std::string& bytes) {
  Node node("publisher");
  // Transient local: it stays in the queue after it was read.
  const auto publisher =
      create_publisher<Sample>(node, topic_of_dying_publisher, QoS(1).transient_local());
  auto message = publisher->borrow_loaned_message();
  message->bytes.resize(std::strtoull(bytes.c_str(), nullptr, 10), 1);
  if (!publisher->publish(std::move(message))) ::_exit(1);
  say_ready();
  wait_for_death();
}

[[noreturn]] void be_subscriber() {
  Node node("subscriber");
  const auto subscription = create_subscription<Sample>(node, topic_of_dying_subscriber, QoS(1));
  ipc_shared_ptr<const Sample> held;
  while (!(held = subscription->take())) ::usleep(200);
  touch(*held);
  say_ready();
  wait_for_death();
}

[[noreturn]] void be_stream() {
  Node node("stream");
  const auto publisher = create_publisher<Sample>(node, topic_of_stream, QoS(stream_depth));
  while (publisher->get_linked_subscription_count() == 0) ::usleep(200);
  say_ready();
  timespec next{};
  ::clock_gettime(CLOCK_MONOTONIC, &next);
  for (std::uint64_t number = 1;; ++number) {
    auto message = publisher->borrow_loaned_message();
    message->number = number;
    if (!publisher->publish(std::move(message))) ::_exit(1);
    next.tv_nsec += 1'000'000;
    if (next.tv_nsec >= 1'000'000'000) {
      ++next.tv_sec;
      next.tv_nsec -= 1'000'000'000;
    }
    ::clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, nullptr);
  }
}

[[noreturn]] void be_idle(const std::string& topic) {
  Node node("idle");
  const auto publisher = create_publisher<Sample>(node, topic, QoS(1));
  const auto subscription = create_subscription<Sample>(node, topic, QoS(1));
  say_ready();
  wait_for_death();
}

using Arguments = std::vector<std::string>;
const RegisterRole publisher("death-publisher",
                             [](const Arguments& all) -> int { be_publisher(all.at(0)); });
const RegisterRole subscriber("death-subscriber", [](const Arguments&) -> int { be_subscriber(); });
const RegisterRole stream("death-stream", [](const Arguments&) -> int { be_stream(); });
const RegisterRole idle("death-idle", [](const Arguments& all) -> int { be_idle(all.at(0)); });

}  // namespace
}  // namespace agnocast::bench
