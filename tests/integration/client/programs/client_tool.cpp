// SPDX-License-Identifier: Apache-2.0
//
// A process that uses the library's untyped core, steered line by line on its standard input;
// answers each line with one line. Linked with the heap hook, so it can publish. Used by the
// integration tests.
//
//   sub TOPIC DEPTH [tl] [all] [others] · pub TOPIC DEPTH [tl] [all]    → ok | error CODE WHAT
//       others: from other processes only
//   persistent_id                      → persistent endpoint id of the publisher
//   forge ID                → ok      claims to be that publisher, and to have moved
//   connect                      → ok | error …
//   state                        → connected | reconnecting | orphaned CODE | …
//   publish COUNT ELEMENTS       → ok | error …          numbers continue from 1
//   take                         → none | NUMBER | damaged       holds the message
//   release                      → ok | damaged | none   the oldest held message
//   wait MS                      → news | timeout        sleeps like an executor
//   lost · allocated · links · unsub · unpub · quit      → a number | ok
//   unreachable · malformed · first_window      → a number
//   occupy ADDRESS BYTES         → ok | error       maps memory there
//   address                      → of the oldest held message | none
//   fork                         → PID of a child that lives until it is killed

#include <client/session/context.hpp>

#include <agnocast/message_type.hpp>

#include <sys/epoll.h>
#include <sys/mman.h>
#include <unistd.h>

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <deque>
#include <iostream>
#include <memory>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace agnocast {
namespace {

/// An unsized message: its elements lie behind a pointer, and nested once more.
struct Cloud {
  std::uint64_t number = 0;
  std::vector<std::uint64_t> points;
  std::vector<std::string> names;
};

std::uint64_t element(std::uint64_t number, std::uint64_t i) {
  return (number + 1) * 0x9e3779b97f4a7c15 ^ i;
}

void fill(Cloud& cloud, std::uint64_t number, std::uint64_t count) {
  cloud.number = number;
  for (std::uint64_t i = 0; i < count; ++i)
    cloud.points.push_back(element(number, i));  // grows in steps
  for (std::uint64_t i = 0; i < number % 7; ++i)
    cloud.names.push_back("a name that is too long to be stored inside " +
                          std::to_string(number + i));
}

bool intact(const Cloud& cloud) {
  for (std::uint64_t i = 0; i < cloud.points.size(); ++i) {
    if (cloud.points[i] != element(cloud.number, i)) return false;
  }
  if (cloud.names.size() != cloud.number % 7) return false;
  for (std::uint64_t i = 0; i < cloud.names.size(); ++i) {
    if (cloud.names[i] !=
        "a name that is too long to be stored inside " + std::to_string(cloud.number + i))
      return false;
  }
  return true;
}

class Tool {
 public:
  std::string execute(std::istringstream& line) {
    std::string what;
    line >> what;
    if (what == "sub") return subscribe(line);
    if (what == "pub") return advertise(line);
    if (what == "publish") return publish(line);
    if (what == "take") return take();
    if (what == "release") return release();
    if (what == "wait") return wait(line);
    if (what == "lost") return std::to_string(subscription_->lost());
    if (what == "unreachable") return std::to_string(subscription_->unreachable());
    if (what == "malformed") return std::to_string(subscription_->malformed());
    if (what == "first_window")
      return std::to_string(Context::instance().heap()->hook().first_window());
    if (what == "occupy") return occupy(line);
    if (what == "address")
      return held_.empty() ? "none" : std::to_string(held_.front().taken.address);
    if (what == "links") return std::to_string(subscription_->link_count());
    if (what == "allocated") return std::to_string(publisher_->allocated_count());
    if (what == "persistent_id") return std::to_string(publisher_->persistent_id());
    if (what == "forge") return forge(line);
    if (what == "state") return state();
    if (what == "fork") return fork_child();
    if (what == "connect") return connect();
    if (what == "matched")
      return std::to_string(publisher_->subscription_count(PublisherEndpoint::Readers::linked));
    if (what == "counted") return std::to_string(publisher_->subscription_count());
    if (what == "unsub") {
      Context::instance().destroy(subscription_);
      subscription_.reset();
      return "ok";
    }
    if (what == "unpub") {
      Context::instance().destroy(publisher_);
      publisher_.reset();
      return "ok";
    }
    return "error unknown command " + what;
  }

 private:
  static std::string text_of(const Failure& failure) {
    return "error " + std::to_string(static_cast<int>(failure.code)) + " " +
           agnocast::text_of(failure);
  }
  static std::string state() {
    switch (connection_state()) {
      case ConnectionState::unconnected:
        return "unconnected";
      case ConnectionState::connected:
        return "connected";
      case ConnectionState::reconnecting:
        return "reconnecting";
      case ConnectionState::orphaned:
        break;
    }
    return "orphaned " + std::to_string(static_cast<int>(orphan_reason()));
  }
  // Makes an unmatched endpoint, gone at once.
  static std::string connect() {
    const std::string topic = "/client_tool_" + std::to_string(::getpid());
    EndpointRequest request;
    request.topic = topic;
    request.type = "tests/Cloud";
    request.node = "/client_tool";
    request.quota = 1;
    const auto idle = Context::instance().idle_wait_set();
    if (!idle) return text_of(idle.error());
    const auto created = Context::instance().create_subscription(request, *idle);
    if (!created) return text_of(created.error());
    Context::instance().destroy(*created);
    return "ok";
  }
  static EndpointRequest request(std::istringstream& line, std::string& topic) {
    EndpointRequest request;
    std::string flag;
    line >> topic >> request.qos.depth >> flag;
    request.topic = topic;
    request.type = "tests/Cloud";
    request.node = "/client_tool";
    request.layout_hash = sizeof(Cloud);
    for (; !flag.empty(); flag.clear(), line >> flag) {
      request.qos.transient_local = request.qos.transient_local || flag == "tl";
      request.qos.keep_all = request.qos.keep_all || flag == "all";
      request.qos.ignore_local = request.qos.ignore_local || flag == "others";
    }
    request.quota = 16;
    return request;
  }

  static std::string fork_child() {
    const pid_t pid = ::fork();
    if (pid == 0) {
      ::close_range(0, 2, 0);  // not the pipe whose closing ends the parent
      for (;;) ::pause();
    }
    return std::to_string(pid);
  }
  std::string forge(std::istringstream& line) {
    std::uint64_t persistent_id = 0;
    line >> persistent_id;
    const auto& words = publisher_->identity().words;
    words.persistent_id().store(persistent_id, std::memory_order_relaxed);
    words.intent_op().store(abi::intent_moved, std::memory_order_release);
    return "ok";
  }

  static std::string occupy(std::istringstream& line) {
    std::uint64_t address = 0, bytes = 0;
    line >> address >> bytes;
    void* const wanted = reinterpret_cast<void*>(address);
    return ::mmap(wanted, bytes, PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED_NOREPLACE, -1,
                  0) == wanted
               ? "ok"
               : "error it is taken";
  }

  std::string subscribe(std::istringstream& line) {
    if (wait_set_ == nullptr) {
      auto wait_set = Context::instance().create_wait_set();
      if (!wait_set) return text_of(wait_set.error());
      wait_set_ = *wait_set;
      epoll_.reset(::epoll_create1(EPOLL_CLOEXEC));
      if (const auto added = wait_set_->add_to(epoll_.get(), 1, 2); !added)
        return text_of(added.error());
    }
    std::string topic;
    auto created = Context::instance().create_subscription(request(line, topic), wait_set_);
    if (!created) return text_of(created.error());
    subscription_ = *created;
    return "ok";
  }

  std::string advertise(std::istringstream& line) {
    std::string topic;
    auto created =
        Context::instance().create_publisher(request(line, topic), detail::MessageEnd::of<Cloud>());
    if (!created) return text_of(created.error());
    publisher_ = *created;
    number_ = 0;
    return "ok";
  }

  /// Returns the next message, all of it in the windows; null: there is no room.
  std::unique_ptr<Cloud> make_shared(std::uint64_t elements) const {
    // The control thread may not have opened the next window yet.
    for (int i = 0; i < 1000; ++i) {
      const SharedHeap heap = Context::instance().shared_heap();
      SharedScope scope(heap);
      auto cloud = std::make_unique<Cloud>();
      fill(*cloud, number_ + 1, elements);
      if (scope.close() == 0) return cloud;
      cloud.reset();
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    return nullptr;
  }

  std::string publish(std::istringstream& line) {
    std::uint64_t count = 0, elements = 0;
    line >> count >> elements;
    for (std::uint64_t i = 0; i < count; ++i) {
      std::unique_ptr<Cloud> cloud = make_shared(elements);
      if (cloud == nullptr) return "error no room";
      const auto outcome = publisher_->publish(cloud.get(), sizeof(Cloud), sizeof(Cloud));
      if (outcome != dataplane::PublishOutcome::published)
        return "error outcome " + std::to_string(static_cast<int>(outcome));
      (void)cloud.release();  // NOLINT: it belongs to the queue now
      ++number_;
    }
    return "ok";
  }

  std::string take() {
    struct Place final : Receiver {
      Received* place(Link&) noexcept override { return &received; }
      Received received;
    };
    Place receiver;
    if (!subscription_->take(receiver)) return subscription_->malformed() == 0 ? "none" : "damaged";
    held_.push_back(receiver.received);
    const Cloud& cloud = *reinterpret_cast<const Cloud*>(receiver.received.taken.address);
    return intact(cloud) ? std::to_string(cloud.number) : "damaged";
  }

  std::string release() {
    if (held_.empty()) return "none";
    const Received oldest = held_.front();
    held_.pop_front();
    const bool unchanged = intact(*reinterpret_cast<const Cloud*>(oldest.taken.address));
    oldest.release();
    return unchanged ? "ok" : "damaged";
  }

  std::string wait(std::istringstream& line) {
    int milliseconds = 0;
    line >> milliseconds;
    for (;;) {
      wait_set_->arm();
      if (subscription_->has_news()) {
        wait_set_->disarm();
        return "news";
      }
      epoll_event event{};
      const int count = ::epoll_wait(epoll_.get(), &event, 1, milliseconds);
      wait_set_->disarm();
      if (count == 0) return "timeout";
      if (count > 0 && event.data.u64 == 2) wait_set_->drain();
      if (subscription_->has_news()) return "news";
    }
  }

  std::shared_ptr<WaitSet> wait_set_;
  UniqueFd epoll_;
  std::shared_ptr<SubscriptionEndpoint> subscription_;
  std::shared_ptr<PublisherEndpoint> publisher_;
  std::deque<Received> held_;
  std::uint64_t number_ = 0;
};

}  // namespace
}  // namespace agnocast

int main() {
  agnocast::Tool tool;
  std::string text;
  while (std::getline(std::cin, text) && text != "quit") {
    std::istringstream line(text);
    std::cout << tool.execute(line) << std::endl;
  }
  return 0;
}
