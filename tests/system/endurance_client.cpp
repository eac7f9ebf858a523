// SPDX-License-Identifier: Apache-2.0
//
// A small node for the endurance tests: starts fast (no rosidl libraries), sends unsized messages.
//
//   endurance_client once-pub|once-sub TOPIC STEPS
//     joins; STEPS 0: ends at once without leaving; 1: publishes or takes one; 2: leaves properly
//   endurance_client        steered line by line on its standard input, one answer per line:
//     pub TOPIC · sub TOPIC            keep-all 100
//     publish COUNT                    → ok
//     receive COUNT                    → ok      each one whole, in order, none lost
//     cycle pub|sub TOPIC COUNT        → ok      creates and destroys, each on its own topic
//     rejoin TOPIC COUNT               → ok      a subscription comes and goes on the same topic
//     heap                             → USED FRONTIER LIVE of the shared heap, bytes
//     links                            → matched endpoints
//     also pub|sub TOPIC               → ok      one more, keep-last 5; it does not read until
//     drain                            → ok
//     one                              → ok      the next message of that one, whole

#include <tests/system/sheaf.hpp>

#include <agnocast/abi/heaphook.h>
#include <agnocast/agnocast.hpp>

#include <dlfcn.h>
#include <unistd.h>

#include <cstdint>
#include <cstdio>
#include <cstring>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

namespace agnocast::test {
namespace {

struct Node {
  const char* get_name() const { return "endurance"; }
  const char* get_namespace() const { return "/"; }
  const char* get_fully_qualified_name() const { return "/endurance"; }
};

QoS keep_all() { return QoS(100).keep_all(100); }

class Client {
 public:
  std::string execute(std::istringstream& line) {
    std::string what;
    line >> what;
    if (what == "heap") return heap();
    if (what == "links")
      return std::to_string(publisher_ != nullptr ? publisher_->get_linked_subscription_count()
                                                  : subscription_->get_linked_publisher_count());
    std::string topic;
    std::uint64_t count = 0;
    if (what == "pub")
      return line >> topic, publisher_ = create_publisher<Sheaf>(node_, topic, keep_all()), "ok";
    if (what == "sub")
      return line >> topic, subscription_ = create_subscription<Sheaf>(node_, topic, keep_all()),
                            "ok";
    if (what == "publish") return line >> count, publish(count);
    if (what == "receive") return line >> count, receive(count);
    if (what == "rejoin") return line >> topic >> count, rejoin(topic, count);
    if (what == "also") {
      std::string kind;
      line >> kind >> topic;
      if (kind == "pub")
        return also_publisher_ = create_publisher<Sheaf>(node_, topic, QoS(5)), "ok";
      return also_subscription_ = create_subscription<Sheaf>(node_, topic, QoS(5)), "ok";
    }
    if (what == "drain") {
      while (also_subscription_->take()) {
      }
      return "ok";
    }
    if (what == "one") return one();
    if (what == "cycle") {
      std::string kind;
      line >> kind >> topic >> count;
      return cycle(kind == "pub", topic, count);
    }
    return "unknown " + what;
  }

  std::string publish(std::uint64_t count) {
    for (std::uint64_t i = 0; i < count; ++i) {
      auto loan = publisher_->borrow_loaned_message();
      fill(*loan, published_ + 1);
      for (;;) {
        const PublishResult result = publisher_->publish(std::move(loan));
        if (result && result.adopted_bytes == 0) break;
        if (result.code != Errc::would_block) return sentence_of(result.code);
        ::usleep(200);
      }
      ++published_;
    }
    return "ok";
  }

  std::string receive(std::uint64_t count) {
    for (std::uint64_t i = 0; i < count;) {
      const auto message = subscription_->take();
      if (!message) {
        ::usleep(100);
        continue;
      }
      if (!is_intact(*message, ++received_)) return "differs at " + std::to_string(received_);
      ++i;
    }
    return subscription_->get_lost_count() == 0 ? "ok" : "lost some";
  }

  std::string one() {
    for (int tries = 0; tries < 100'000; ++tries) {
      if (const auto message = also_subscription_->take())
        return is_intact(*message, 1) ? "ok" : "differs";
      ::usleep(100);
    }
    return "nothing came";
  }

  std::string cycle(bool publishers, const std::string& topic, std::uint64_t count) {
    for (std::uint64_t i = 0; i < count; ++i) {
      const std::string name = topic + "/t" + std::to_string(cycles_++);
      if (publishers) {
        create_publisher<Sheaf>(node_, name, QoS(1));
      } else {
        create_subscription<Sheaf>(node_, name, QoS(1));
      }
    }
    return "ok";
  }
  std::string rejoin(const std::string& topic, std::uint64_t count) {
    for (std::uint64_t i = 0; i < count; ++i) create_subscription<Sheaf>(node_, topic, QoS(1));
    return "ok";
  }

  static std::string heap() {
    using Find = const agnocast_heaphook_table* (*)();
    const auto find = reinterpret_cast<Find>(::dlsym(RTLD_DEFAULT, "agnocast_heaphook"));
    if (find == nullptr) return "0 0 0";
    agnocast_heaphook_usage usage{};
    find()->usage(&usage);
    return std::to_string(usage.used_bytes) + " " + std::to_string(usage.frontier_bytes) + " " +
           std::to_string(usage.live_bytes);
  }

  int once(const std::string& what, const std::string& topic, int steps) {
    if (what == "once-pub") {
      publisher_ = create_publisher<Sheaf>(node_, topic, QoS(1));
      if (steps > 0 && publish(1) != "ok") return 1;
    } else {
      subscription_ = create_subscription<Sheaf>(node_, topic, QoS(1));
      if (steps > 0) (void)subscription_->take();
    }
    if (steps < 2) ::_exit(0);
    return 0;
  }

 private:
  Node node_;
  Publisher<Sheaf>::SharedPtr publisher_, also_publisher_;
  Subscription<Sheaf>::SharedPtr subscription_, also_subscription_;
  std::uint64_t published_ = 0, received_ = 0, cycles_ = 0;
};

}  // namespace
}  // namespace agnocast::test

int main(int argc, char** argv) {
  agnocast::test::Client client;
  if (argc == 4) {
    try {
      return client.once(argv[1], argv[2], std::atoi(argv[3]));
    } catch (const std::exception& error) {
      std::fprintf(stderr, "%s\n", error.what());
      return 1;
    }
  }
  std::string text;
  while (std::getline(std::cin, text)) {
    std::istringstream line(text);
    std::string answer;
    try {
      answer = client.execute(line);
    } catch (const std::exception& error) {
      answer = error.what();
    }
    std::cout << answer << std::endl;
  }
  return 0;
}
