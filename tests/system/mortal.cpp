// SPDX-License-Identifier: Apache-2.0
//
// A node for death_test.cpp to kill, stop and revoke.
//
//   mortal once TOPIC QOS COUNT    publishes 1 … COUNT and ends at once without leaving
//   mortal                         steered line by line on its standard input, one line for each:
//     pub TOPIC QOS · sub TOPIC QOS QUOTA   → ok | refused TEXT
//     publish COUNT                         → ok | refused SENTENCE     numbers go on
//     once TOPIC QOS COUNT                  → publishes with a new publisher, ends without leaving
//     take                                  → none | NUMBER | damaged   holds the message
//     expect FIRST LAST                     → ok | …  takes and releases these, in this order
//     rest                                  → FIRST LAST | none | …  takes and releases the rest
//     check · drop                          → ok | damaged  all held messages; releases them
//     window                                → the window in which the next message would lie
//     maps                                  → mappings of other processes' memory
//     barrier                               → ok    the client has handled all earlier packets
//     active                                → PUBLISHER SUBSCRIPTION
//     lost · matched                        → a number
//     events                                → CALLS CURRENT of the matched callback
//   QOS: a depth, then t (transient local), a (keep-all)

#include <tests/support/processes/actor.hpp>
#include <tests/support/processes/spun.hpp>
#include <tests/system/sheaf.hpp>

#include <agnocast/agnocast.hpp>

#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace agnocast::test {
namespace {

class Mortal {
 public:
  std::string execute(std::istringstream& line) {
    std::string what, topic, qos;
    std::uint64_t count = 0;
    line >> what;
    if (what == "pub") return line >> topic >> qos, advertise(topic, qos);
    if (what == "sub") return line >> topic >> qos >> count, subscribe(topic, qos, count);
    if (what == "once") {
      line >> topic >> qos >> count;
      if (advertise(topic, qos) != "ok" || publish(count) != "ok") return "not published";
      ::_exit(0);
    }
    if (what == "publish") return line >> count, publish(count);
    if (what == "take") return take();
    if (what == "rest") return rest();
    if (what == "check" || what == "drop") return check(what == "drop");
    if (what == "window") return window();
    if (what == "maps") return std::to_string(foreign_mappings());
    if (what == "barrier") return barrier();
    if (what == "lost") return std::to_string(subscription_->get_lost_count());
    if (what == "events")
      return std::to_string(event_calls_.load()) + " " + std::to_string(event_current_.load());
    if (what == "matched")
      return std::to_string(publisher_ != nullptr ? publisher_->get_linked_subscription_count()
                                                  : subscription_->get_linked_publisher_count());
    if (what == "active")
      return std::to_string(publisher_ != nullptr && publisher_->is_active()) + " " +
             std::to_string(subscription_ != nullptr && subscription_->is_active());
    if (what == "expect") {
      std::uint64_t last = 0;
      line >> count >> last;
      return expect(count, last);
    }
    return "unknown " + what;
  }

  std::string advertise(const std::string& topic, const std::string& qos) {
    PublisherOptions options;
    options.matched_callback([this](MatchedInfo& info) { note(info); });
    auto made = try_create_publisher<Sheaf>(node_, topic, qos_from_letters(qos), options);
    if (!made) return "refused " + text_of(made.error());
    publisher_ = *made;
    return "ok";
  }
  std::string publish(std::uint64_t count) {
    for (; count > 0; --count) {
      auto loan = publisher_->borrow_loaned_message();
      fill(*loan, published_ + 1);
      const PublishResult result = publisher_->publish(std::move(loan));
      if (!result) return std::string("refused ") + sentence_of(result.code);
      ++published_;
    }
    return "ok";
  }

 private:
  struct Held {
    ipc_shared_ptr<const Sheaf> message;
    std::uint64_t number;
  };

  void note(const MatchedInfo& info) {
    event_current_ = static_cast<int>(info.current_count);
    ++event_calls_;
  }
  std::string subscribe(const std::string& topic, const std::string& qos, std::uint64_t quota) {
    SubscriptionOptions options;
    options.hold_quota(quota);
    options.matched_callback([this](MatchedInfo& info) { note(info); });
    auto made = try_create_subscription<Sheaf>(node_, topic, qos_from_letters(qos), options);
    if (!made) return "refused " + text_of(made.error());
    subscription_ = *made;
    return "ok";
  }
  std::string take() {
    auto message = subscription_->take();
    if (!message) return "none";
    const std::uint64_t number = message->number;
    if (!is_intact(*message, number)) return "damaged";
    held_.push_back({std::move(message), number});
    return std::to_string(number);
  }
  std::string rest() {
    std::uint64_t first = 0, last = 0;
    while (auto message = subscription_->take()) {
      if (!is_intact(*message, message->number)) return "damaged";
      if (last != 0 && message->number != last + 1)
        return std::to_string(message->number) + " after " + std::to_string(last);
      last = message->number;
      if (first == 0) first = last;
    }
    return last == 0 ? "none" : std::to_string(first) + " " + std::to_string(last);
  }
  std::string expect(std::uint64_t first, std::uint64_t last) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::minutes(5);
    while (first <= last) {
      const auto message = subscription_->take();
      if (!message) {
        if (std::chrono::steady_clock::now() > end)
          return "no message " + std::to_string(first) + ", lost " +
                 std::to_string(subscription_->get_lost_count());
        std::this_thread::sleep_for(std::chrono::microseconds(100));
        continue;
      }
      if (!is_intact(*message, first))
        return std::to_string(message->number) + " instead of " + std::to_string(first);
      ++first;
    }
    return "ok";
  }
  std::string check(bool drop) {
    bool intact = true;
    for (const Held& held : held_) intact = intact && is_intact(*held.message, held.number);
    if (drop) held_.clear();
    return intact ? "ok" : "damaged";
  }
  std::string window() {
    const auto loan = publisher_->borrow_loaned_message();
    // The daemon of these tests gives windows of 64 MiB.
    return std::to_string(reinterpret_cast<std::uint64_t>(loan.get()) >> 26);
  }
  // The names are the daemon's memfds; others' are read-only.
  static std::size_t foreign_mappings() {
    std::size_t count = 0;
    std::ifstream maps("/proc/self/maps");
    for (std::string line; std::getline(maps, line);) {
      const bool is_ours = line.find("/memfd:agnocast-heap") != std::string::npos ||
                           line.find("/memfd:agnocast-region") != std::string::npos;
      if (is_ours && line.find(" r--s ") != std::string::npos) ++count;
    }
    return count;
  }
  // The answer to a request comes after all earlier packets of the daemon.
  std::string barrier() {
    const auto asked = try_create_subscription<Sheaf>(node_, "/barrier", QoS(1));
    return asked ? "ok" : "refused " + text_of(asked.error());
  }

  Spun<ActorNode> node_{"mortal"};
  Publisher<Sheaf>::SharedPtr publisher_;
  Subscription<Sheaf>::SharedPtr subscription_;
  std::vector<Held> held_;
  std::uint64_t published_ = 0;
  std::atomic<int> event_calls_{0}, event_current_{-1};
};

}  // namespace
}  // namespace agnocast::test

int main(int argc, char** argv) {
  agnocast::test::Mortal mortal;
  if (argc == 5) {
    if (mortal.advertise(argv[2], argv[3]) != "ok") return 2;
    if (mortal.publish(std::strtoull(argv[4], nullptr, 10)) != "ok") return 3;
    ::_exit(0);
  }
  std::string text;
  while (std::getline(std::cin, text)) {
    std::istringstream line(text);
    std::cout << mortal.execute(line) << std::endl;
  }
  return 0;
}
