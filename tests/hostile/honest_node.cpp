// SPDX-License-Identifier: Apache-2.0
//
// The honest side of the hostile tests: an ordinary node on the public interface, with a publisher
// or subscriptions, that counts every promise that was not kept.
//
//   honest_node UID     becomes that user first (0: keeps its user)
//   then line by line on its standard input, each answered with one line:
//     publish TOPIC     → ok      a Numbered every few milliseconds from now on, in its own thread
//     subscribe TOPIC   → ok      checks number and content of each, holds the last few, rechecks
//     join TOPIC        → ok      the same with a stream that has begun: the first number is any
//     occupy ADDRESS BYTES → ok   maps memory there
//     watch TOPIC       → ok      takes messages of others unread, notes their addresses
//     publish_bulk TOPIC → ok    a mebibyte every few milliseconds; keeps only the newest
//     publish_flat TOPIC → ok    a publisher of Flat that publishes nothing
//     enter-user-namespace → ok   comes first: its uid then differs from what the daemon sees
//     limit-addresses   → ok      from now on this process can map no region of another process
//     create TOPIC      → ok      creates a publisher and a subscription, and destroys them
//     collisions        → how many collisions of addresses the daemon reported to its publisher
//     matched           → how many endpoints match its own endpoint
//     forget-gap        → ok      resets the largest gap between two messages
//     state → published refused received wrong lost watched low high watch_lost gap refusal
//                         gap: the largest between two messages, received or published
//     stop              → ok      publishes no more

#include <base/clock.hpp>
#include <tests/hostile/messages.hpp>
#include <tests/hostile/steered_main.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/spun.hpp>

#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <deque>
#include <fstream>
#include <optional>
#include <sstream>
#include <string>
#include <thread>
#include <utility>

namespace agnocast::test {
namespace {

// Deep and slow enough that a busy machine may stop the reader for seconds without a loss.
constexpr std::uint32_t depth = 1000;
constexpr std::chrono::milliseconds period{3};

class HonestNode {
 public:
  ~HonestNode() { stop(); }

  std::string execute(std::istringstream& line) {
    std::string what, topic;
    line >> what >> topic;
    if (what == "publish") return publish(topic);
    if (what == "subscribe" || what == "join") return subscribe(topic, what == "join");
    if (what == "occupy") return occupy(topic, line);
    if (what == "watch") return watch(topic);
    if (what == "limit-addresses") return limit_addresses();
    // Without a uid map its uid is the overflow uid, 65534.
    if (what == "enter-user-namespace")
      return ::unshare(CLONE_NEWUSER) == 0 ? "ok" : std::strerror(errno);
    if (what == "create") return create(topic);
    if (what == "publish_flat") return publish_flat(topic);
    if (what == "publish_bulk") return publish_bulk(topic);
    if (what == "stop") return stop(), "ok";
    if (what == "collisions")
      return std::to_string(publisher_->get_heap_collision_status().total_count);
    if (what == "matched")
      return std::to_string(
          (publisher_ != nullptr ? publisher_->get_linked_subscription_count() : 0) +
          (subscription_ != nullptr ? subscription_->get_linked_publisher_count() : 0) +
          (watched_ != nullptr ? watched_->get_linked_publisher_count() : 0));
    if (what == "forget-gap") return largest_gap_ns_.store(0), "ok";
    if (what == "state") return state();
    return "unknown " + what;
  }

 private:
  std::string publish(const std::string& topic) {
    publisher_ = create_publisher<Numbered>(PlainNode(), topic, QoS(depth));
    thread_ = std::thread([this] {
      std::uint64_t copied = 0;
      for (std::uint64_t number = 1; !stopped_.load(); ++number) {
        auto message = publisher_->borrow_loaned_message();
        fill(*message, number);
        const PublishResult result = publisher_->publish(std::move(message));
        if (result) published_.store(number), note_gap();
        // Only one loan is open at a time, so each move of the heap may cause one copy.
        if (result && result.adopted_bytes != 0) ++copied;
        const auto moves = publisher_->get_heap_collision_status().total_count;
        if (!result || copied > static_cast<std::uint64_t>(moves)) {
          ++refused_;
          refusal_.store(sentence_of(result.code));
        }
        std::this_thread::sleep_for(period);
      }
    });
    return "ok";
  }

  std::string publish_bulk(const std::string& topic) {
    bulk_ = create_publisher<Bulk>(PlainNode(), topic, QoS(1));
    thread_ = std::thread([this] {
      for (std::uint64_t number = 1; !stopped_.load(); ++number) {
        auto message = bulk_->borrow_loaned_message();
        message->number = number;
        message->data.resize(Bulk::bytes);
        if (const PublishResult result = bulk_->publish(std::move(message)); result) {
          ++published_;
          note_gap();
        } else {
          ++refused_;
          refusal_.store(sentence_of(result.code));
        }
        std::this_thread::sleep_for(period);
      }
    });
    return "ok";
  }

  static std::string limit_addresses() {
    std::uint64_t pages = 0;
    std::ifstream("/proc/self/statm") >> pages;
    // A region takes a gibibyte of addresses.
    const rlim_t most =
        pages * static_cast<std::uint64_t>(::sysconf(_SC_PAGESIZE)) + (rlim_t{512} << 20);
    const rlimit limit{most, most};
    return ::setrlimit(RLIMIT_AS, &limit) == 0 ? "ok" : "no";
  }

  static std::string occupy(const std::string& address, std::istringstream& line) {
    std::uint64_t bytes = 0;
    line >> bytes;
    void* const wanted = reinterpret_cast<void*>(std::stoull(address));
    return ::mmap(wanted, bytes, PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED_NOREPLACE, -1,
                  0) == wanted
               ? "ok"
               : "it is taken";
  }

  std::string subscribe(const std::string& topic, bool has_begun) {
    subscription_ = create_subscription<Numbered>(
        node(), topic, QoS(depth), [this, has_begun](ipc_shared_ptr<const Numbered> message) {
          const std::uint64_t received = received_.load() + 1;
          if (has_begun && received == 1) missed_ = message->number - 1;
          const std::uint64_t number = missed_ + received;
          note_gap();
          if (!is_intact(*message, number)) ++wrong_;
          received_.store(received);
          held_.push_back(std::move(message));
          if (held_.size() <= 8) return;
          if (!is_intact(*held_.front(), number - 8)) ++wrong_;
          held_.pop_front();
        });
    return "ok";
  }

  void note_gap() {
    const std::uint64_t now = monotonic_ns();
    const std::uint64_t before = std::exchange(last_ns_, now);
    if (before != 0 && now - before > largest_gap_ns_.load()) largest_gap_ns_.store(now - before);
  }

  std::string watch(const std::string& topic) {
    watched_ = create_subscription<Flat>(
        node(), topic, QoS(100), [this](ipc_shared_ptr<const Flat> message) {
          const auto at = reinterpret_cast<std::uint64_t>(message.get());
          // Read completely: every message that was handed out has to be readable.
          std::uint64_t sum = 0;
          for (const std::uint64_t word : message->word) sum += word;
          sum_.store(sum);
          if (at < low_.load()) low_.store(at);
          if (at + sizeof(Flat) > high_.load()) high_.store(at + sizeof(Flat));
          ++seen_;
        });
    return "ok";
  }

  std::string create(const std::string& topic) {
    auto publisher = try_create_publisher<Flat>(node(), topic, QoS(1));
    if (!publisher) return sentence_of(publisher.error().code);
    auto subscription = try_create_subscription<Flat>(node(), topic, QoS(1));
    return subscription ? "ok" : sentence_of(subscription.error().code);
  }

  std::string publish_flat(const std::string& topic) {
    auto made = try_create_publisher<Flat>(node(), topic, QoS(1));
    if (!made) return sentence_of(made.error().code);
    flat_ = *made;
    return "ok";
  }

  // Made late: a process with threads cannot enter a user namespace.
  Spun<PlainNode>& node() {
    if (!node_) node_.emplace();
    return *node_;
  }

  std::string state() const {
    std::ostringstream text;
    text << published_.load() << ' ' << refused_.load() << ' ' << received_.load() << ' '
         << wrong_.load() << ' ' << (subscription_ ? subscription_->get_lost_count() : 0) << ' '
         << seen_.load() << ' ' << low_.load() << ' ' << high_.load() << ' '
         << (watched_ ? watched_->get_lost_count() : 0) << ' ' << largest_gap_ns_.load() << ' '
         << refusal_.load();
    return text.str();
  }

  void stop() {
    stopped_.store(true);
    if (thread_.joinable()) thread_.join();
  }

  std::optional<Spun<PlainNode>> node_;
  std::atomic<std::uint64_t> published_{0}, refused_{0}, received_{0}, wrong_{0};
  std::atomic<std::uint64_t> seen_{0}, low_{~std::uint64_t{0}}, high_{0}, sum_{0};
  std::atomic<const char*> refusal_{""};
  std::atomic<bool> stopped_{false};
  std::deque<ipc_shared_ptr<const Numbered>> held_;  // used only by the callback
  std::uint64_t missed_ = 0, last_ns_ = 0;           // likewise
  std::atomic<std::uint64_t> largest_gap_ns_{0};
  Publisher<Numbered>::SharedPtr publisher_;
  Publisher<Flat>::SharedPtr flat_;
  Publisher<Bulk>::SharedPtr bulk_;
  Subscription<Numbered>::SharedPtr subscription_;
  Subscription<Flat>::SharedPtr watched_;
  std::thread thread_;
};

}  // namespace
}  // namespace agnocast::test

int main(int argc, char** argv) {
  return agnocast::test::steered_main<agnocast::test::HonestNode>(argc, argv);
}
