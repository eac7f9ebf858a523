// SPDX-License-Identifier: Apache-2.0
//
// The publisher of the demo. Needs the heap hook. Executes the orders on its standard input and
// answers each with lines that end with "end", or with "failed WHY":
//
//   wait cloud|latency|dds COUNT       until that many subscriptions are matched
//   clouds FIRST COUNT BYTES           builds and publishes COUNT messages; for each
//                                        sent NUMBER ADOPTED_BYTES PLACES
//   corrupt                            the next message gets one wrong byte after it was sealed
//   move_in NUMBER BYTES               msg->data = std::move(v), v built before the loan was borrowed
//   latency BYTES COUNT SECONDS dds|alone
//                                      COUNT messages per transport in turn, fewer if time is up
//                                        latency ROAD COUNT P50_NS P99_NS WRONG LOST

#include <agnocast/agnocast.hpp>
#include <examples/demo/ack.hpp>
#include <examples/demo/content.hpp>
#include <examples/demo/cores.hpp>
#include <examples/demo/dds_road.hpp>

#include <poll.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <iostream>
#include <sstream>
#include <stdexcept>
#include <thread>

namespace demo {
namespace {

using Clock = std::chrono::steady_clock;
using namespace std::chrono_literals;

// Longer than anything here takes on a busy machine.
constexpr auto patience = 30s;
constexpr int ack_timeout_ms = 3000;

// First number of messages that the demo does not number: prototypes and timed messages.
constexpr std::uint64_t first_timed_number = 1000000;

struct Failure : std::runtime_error {
  using std::runtime_error::runtime_error;
};

/// Latencies of one transport in one round.
struct Latencies {
  std::vector<std::uint64_t> samples_ns;
  std::uint64_t wrong = 0;
  std::uint64_t lost = 0;

  std::uint64_t quantile(double part) {
    if (samples_ns.empty()) return 0;
    std::sort(samples_ns.begin(), samples_ns.end());
    return samples_ns[static_cast<std::size_t>(part * static_cast<double>(samples_ns.size() - 1))];
  }
  void print(const char* road) {
    std::printf("latency %s %zu %llu %llu %llu %llu\n", road, samples_ns.size(),
                static_cast<unsigned long long>(quantile(0.5)),
                static_cast<unsigned long long>(quantile(0.99)),
                static_cast<unsigned long long>(wrong), static_cast<unsigned long long>(lost));
  }
};

class Work {
 public:
  explicit Work(agnocast::Node& node, bool with_dds)
      : clouds_(agnocast::create_publisher<Cloud>(node, "/demo/cloud", agnocast::QoS(1))),
        timed_(agnocast::create_publisher<Cloud>(node, "/demo/latency", agnocast::QoS(1))) {
    std::string why;
    if (with_dds) dds_ = DdsWriter::make("rt/demo/latency", why);
    if (with_dds && dds_ == nullptr) std::printf("no_dds %s\n", why.c_str());
  }

  void obey(std::istringstream& line) {
    std::string verb;
    line >> verb;
    if (verb == "wait") return wait(line);
    if (verb == "clouds") return send_clouds(line);
    if (verb == "corrupt") return void(corrupt_ = true);
    if (verb == "move_in") return move_in(line);
    if (verb == "latency") return measure(line);
    throw Failure("this is not an order: " + line.str());
  }

 private:
  using Loan = agnocast::ipc_shared_ptr<Cloud>;

  template <class Condition>
  static bool eventually(Condition condition) {
    for (const auto end = Clock::now() + patience; !condition(); std::this_thread::sleep_for(1ms))
      if (Clock::now() > end) return false;
    return true;
  }

  void wait(std::istringstream& line) {
    std::string whom;
    std::size_t count = 0;
    line >> whom >> count;
    const bool matched = eventually([&] {
      if (whom == "dds") return dds_ != nullptr && dds_->is_matched();
      return (whom == "cloud" ? clouds_ : timed_)->get_linked_subscription_count() == count;
    });
    if (!matched && whom == "dds") {
      // The comparison is not the purpose of the demo: it goes on without.
      std::puts("no_dds writer and reader of Cyclone DDS do not find each other");
    } else if (!matched) {
      throw Failure("the subscriptions of " + whom + " did not appear");
    }
  }

  /// Publishes; waits while a keep-all subscription is behind.
  static std::uint64_t publish(agnocast::Publisher<Cloud>& publisher, Loan message) {
    const agnocast::PublishResult result = publisher.publish_for(std::move(message), patience);
    if (!result) throw Failure(std::string("publish: ") + agnocast::sentence_of(result.code));
    return result.adopted_bytes;
  }

  void send_cloud(Loan message) {
    if (std::exchange(corrupt_, false)) message->data[message->data.size() / 2] ^= 1;
    const std::string places = places_of(*message);
    const std::uint64_t number = number_of(*message);
    const std::uint64_t adopted = publish(*clouds_, std::move(message));
    std::printf("sent %llu %llu %s\n", static_cast<unsigned long long>(number),
                static_cast<unsigned long long>(adopted), places.c_str());
  }

  void send_clouds(std::istringstream& line) {
    std::uint64_t first = 0, count = 0, bytes = 0;
    line >> first >> count >> bytes;
    for (std::uint64_t number = first; number < first + count; ++number) {
      auto message = clouds_->borrow_loaned_message();
      build(*message, number, bytes);
      send_cloud(std::move(message));
    }
  }

  void move_in(std::istringstream& line) {
    std::uint64_t number = 0, bytes = 0;
    line >> number >> bytes;
    Random random(number);
    std::vector<std::uint8_t> v;
    build_data(v, bytes, random);
    auto message = clouds_->borrow_loaned_message();
    build_frame(*message, number, bytes, random);
    message->data = std::move(v);
    seal(*message);
    send_cloud(std::move(message));
  }

  /// Waits for the answer to `number`; skips answers to earlier messages that were counted as
  /// lost.
  void await(std::uint64_t number, std::uint64_t sent_ns, Latencies& latencies) {
    const auto end = Clock::now() + std::chrono::milliseconds(ack_timeout_ms);
    for (;;) {
      const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(end - Clock::now());
      pollfd descriptor{ack_descriptor, POLLIN, 0};
      if (left.count() <= 0 || ::poll(&descriptor, 1, static_cast<int>(left.count())) == 0) {
        ++latencies.lost;
        return;
      }
      Ack ack;
      if (::read(ack_descriptor, &ack, sizeof ack) != static_cast<ssize_t>(sizeof ack))
        throw Failure("the subscriber's answers ended");
      if (ack.number != number) continue;
      if (ack.intact == 0) ++latencies.wrong;
      latencies.samples_ns.push_back(ack.received_ns - sent_ns);
      return;
    }
  }

  void time_agnocast(const Cloud& prototype, Latencies& latencies) {
    auto message = timed_->borrow_loaned_message();
    *message = prototype;
    const std::uint64_t number = number_of(prototype);
    std::this_thread::sleep_for(rest);
    const std::uint64_t sent_ns = now_ns();
    if (!timed_->publish(std::move(message))) throw Failure("publish failed");
    await(number, sent_ns, latencies);
  }

  void time_dds(const Cloud& prototype, Latencies& latencies) {
    dds_->fill(prototype);
    const std::uint64_t number = number_of(prototype);
    std::this_thread::sleep_for(rest);
    const std::uint64_t sent_ns = now_ns();
    if (!dds_->write()) return void(++latencies.lost);
    await(number, sent_ns, latencies);
  }

  void measure(std::istringstream& line) {
    std::uint64_t bytes = 0, count = 0;
    double seconds = 0;
    std::string roads;
    line >> bytes >> count >> seconds >> roads;
    const bool with_dds = roads == "dds" && dds_ != nullptr;
    take_first_core();
    Latencies agnocast, dds;
    Cloud prototype;
    build(prototype, next_timed_number_, bytes);
    const std::string frame(unsealed(prototype.header.frame_id));
    const auto end = Clock::now() + std::chrono::duration<double>(seconds);
    // Ten messages go ahead untimed: to touch pages, grow buffers, wake threads.
    for (std::uint64_t i = 0;
         i < count + warm_up && (i < warm_up + samples_min || Clock::now() < end); ++i) {
      if (i == warm_up) {
        agnocast.samples_ns.clear();
        dds.samples_ns.clear();
      }
      prototype.header.stamp.sec = static_cast<std::int32_t>(++next_timed_number_);
      prototype.header.frame_id = frame;
      seal(prototype);
      // The transports alternate at going first, so that neither always meets the other's caches.
      const bool dds_too = with_dds && dds.lost < lost_max;
      if (dds_too && i % 2 == 0) time_dds(prototype, dds);
      time_agnocast(prototype, agnocast);
      if (dds_too && i % 2 == 1) time_dds(prototype, dds);
    }
    agnocast.print("agnocast");
    if (with_dds) dds.print("dds");
  }

  static constexpr std::uint64_t warm_up = 10;
  // Before each message of either transport, after filling: gives both an equally idle receiver
  // core.
  static constexpr auto rest = 1ms;
  // A minimum when time is short: fewer samples mean nothing.
  static constexpr std::uint64_t samples_min = 20;
  // After so many lost messages, DDS is skipped for this round.
  static constexpr std::uint64_t lost_max = 3;

  agnocast::Publisher<Cloud>::SharedPtr clouds_;
  agnocast::Publisher<Cloud>::SharedPtr timed_;
  std::unique_ptr<DdsWriter> dds_;
  bool corrupt_ = false;
  std::uint64_t next_timed_number_ = first_timed_number;
};

int run(const char* name, bool with_dds) {
  agnocast::Node node(name);
  Work work(node, with_dds);
  std::puts("ready");
  std::fflush(stdout);
  for (std::string text; std::getline(std::cin, text);) {
    std::istringstream line(text);
    work.obey(line);
    std::puts("end");
    std::fflush(stdout);
  }
  return 0;
}

}  // namespace
}  // namespace demo

int main(int argc, char** argv) try {
  if (argc < 2 || argv[1] == std::string("--help")) {
    std::fputs("usage: demo_publisher NAME [dds]   (started by the demo)\n", stderr);
    return 2;
  }
  return demo::run(argv[1], argc > 2 && argv[2] == std::string("dds"));
} catch (const agnocast::Error& error) {
  std::fprintf(stderr, "demo_publisher: %s\nhint: %s\n", error.what(),
               agnocast::remedy_of(error.failure().code));
  return 1;
} catch (const std::exception& error) {
  std::printf("failed %s\n", error.what());
  return 1;
}
