// SPDX-License-Identifier: Apache-2.0

#include <bench/cases/scale_crowd.hpp>
#include <bench/process.hpp>

#include <agnocast/agnocast.hpp>

#include <sys/mman.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <new>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::bench {

/// Small and flat: the number is measured, not the size of messages.
struct ScaleNote {
  std::uint64_t number = 0;
  std::uint64_t more[7] = {};
};

namespace {

using Clock = std::chrono::steady_clock;
constexpr std::chrono::seconds patience{10};
constexpr std::chrono::microseconds look_every{50};
// So that all threads sleep again before the next message; they may have one core in common.
constexpr std::chrono::microseconds between{1000}, between_for_each{100};

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(Clock::now().time_since_epoch())
      .count();
}

bool is_limit(const Failure& failure) noexcept {
  switch (failure.code) {
    case Errc::quota_exceeded:
    case Errc::limit_reached:
    case Errc::heap_exhausted:
    case Errc::window_exhausted:
    case Errc::address_limit:
    case Errc::lock_limit:
      return true;
    default:
      return bench::is_limit(failure.os_errno);
  }
}

class Crowd {
 public:
  explicit Crowd(int descriptor) : arrivals_(descriptor) { executor_.add_node(node_); }

  std::vector<std::int64_t> obey(const std::string& line) {
    std::istringstream words(line);
    std::string command, topic;
    std::size_t a = 0, b = 0;
    std::uint64_t number = 0;
    words >> command >> topic >> a >> b >> number;
    if (command == "subscribe") return subscribe(topic, a, b);
    if (command == "advertise") return advertise(topic, a);
    if (command == "pairs") return pairs(topic, a, b);
    if (command == "send") return send(topic, a, b, number);
    if (command == "join") return join(topic, a);
    if (command == "speak") return speak(topic, a, b, number);
    throw std::runtime_error("unknown command " + command);
  }

 private:
  using Times = std::vector<std::int64_t>;
  // The last message stays for late joiners, so that a join has a visible end.
  static QoS qos() { return QoS(1).transient_local(); }

  auto make_publisher(const std::string& topic, Times& times) {
    const std::int64_t began = now_ns();
    auto made = create_publisher<ScaleNote>(node_, topic, qos());
    times.push_back(now_ns() - began);
    return made;
  }
  template <class Callback>
  auto make_subscription(const std::string& topic, Times& times, Callback callback) {
    const std::int64_t began = now_ns();
    auto made = create_subscription<ScaleNote>(node_, topic, qos(), std::move(callback));
    times.push_back(now_ns() - began);
    return made;
  }

  Times subscribe(const std::string& topic, std::size_t count, std::size_t place) {
    Times times;
    for (std::size_t i = 0; i < count; ++i)
      subscriptions_.push_back(make_subscription(
          topic, times, [this, at = place + i](const ipc_shared_ptr<const ScaleNote>& note) {
            arrivals_.note(at, note->number);
          }));
    return times;
  }
  Times advertise(const std::string& topic, std::size_t count) {
    Times times;
    for (std::size_t i = 0; i < count; ++i)
      publishers_[topic].push_back(make_publisher(topic, times));
    return times;
  }
  Times pairs(const std::string& prefix, std::size_t first, std::size_t count) {
    Times times;
    for (std::size_t i = first; i < first + count; ++i) {
      const std::string topic = prefix + std::to_string(i);
      publishers_[topic].push_back(make_publisher(topic, times));
      subscriptions_.push_back(
          make_subscription(topic, times, [](const ipc_shared_ptr<const ScaleNote>&) {}));
    }
    return times;
  }

  struct Call {
    std::int64_t began, returned;
  };
  static Call publish(Publisher<ScaleNote>& publisher, std::uint64_t number) {
    auto note = publisher.borrow_loaned_message();
    note->number = number;
    Call call{now_ns(), 0};
    const PublishResult result = publisher.publish(std::move(note));
    call.returned = now_ns();
    if (!result) throw Error(Failure{result.code, 0, "publishing"});
    return call;
  }
  std::int64_t arrival(std::size_t receivers, std::uint64_t number) const {
    const std::int64_t ns = arrivals_.wait_for_last(receivers, number);
    if (ns == 0)
      throw std::runtime_error("message " + std::to_string(number) + " has not come within 10 s");
    return ns;
  }
  Times send(const std::string& topic, std::size_t count, std::size_t receivers,
             std::uint64_t number) {
    Publisher<ScaleNote>& publisher = *publishers_.at(topic).front();
    Times times;
    for (const std::uint64_t end = number + count; number < end; ++number) {
      const Call call = publish(publisher, number);
      times.push_back(call.returned - call.began);
      times.push_back(arrival(receivers, number) - call.began);
      std::this_thread::sleep_for(between + receivers * between_for_each);
    }
    return times;
  }

  Times join(const std::string& topic, std::size_t count) {
    Times times;
    for (std::size_t i = 0; i < count; ++i) {
      std::atomic<std::int64_t> came{0};
      const std::int64_t began = now_ns();
      const auto subscription =
          make_subscription(topic, times, [&came](const ipc_shared_ptr<const ScaleNote>&) {
            if (came == 0) came = now_ns();
          });
      for (const auto end = Clock::now() + patience; came == 0;) {
        if (Clock::now() > end)
          throw std::runtime_error("the last message has not come to a late subscription");
        std::this_thread::sleep_for(look_every);
      }
      times.push_back(came - began);
      std::this_thread::sleep_for(between);
    }
    return times;
  }
  Times speak(const std::string& topic, std::size_t count, std::size_t receivers,
              std::uint64_t number) {
    Times times;
    for (const std::uint64_t end = number + count; number < end; ++number) {
      const std::int64_t began = now_ns();
      const auto publisher = make_publisher(topic, times);
      (void)publish(*publisher, number);
      times.push_back(arrival(receivers, number) - began);
      std::this_thread::sleep_for(between);
    }
    return times;
  }

  Arrivals arrivals_;
  Node node_{"crowd"};
  BackgroundExecutor executor_;
  std::map<std::string, std::vector<Publisher<ScaleNote>::SharedPtr>> publishers_;
  std::vector<Subscription<ScaleNote>::SharedPtr> subscriptions_;
};

/// Returns the answer to a command.
std::string answer_of(const std::function<std::vector<std::int64_t>()>& command) {
  try {
    std::string answer = "ok";
    for (const std::int64_t ns : command()) answer += ' ' + std::to_string(ns);
    return answer;
  } catch (const Error& error) {
    return (is_limit(error.failure()) ? "no " : "failed ") + std::string(error.what());
  } catch (const std::bad_alloc&) {
    return "no memory is left";
  } catch (const std::exception& error) {
    return std::string("failed ") + error.what();
  }
}

int be_crowd(const std::vector<std::string>& arguments) {
  ::prctl(PR_SET_TIMERSLACK, 1UL);
  std::optional<Crowd> crowd;  // made by the first command, whose answer includes errors
  for (std::string line; std::getline(std::cin, line);) {
    std::string answer = answer_of([&] {
      if (!crowd) crowd.emplace(std::atoi(arguments.at(0).c_str()));
      return crowd->obey(line);
    });
    std::replace(answer.begin(), answer.end(), '\n', ' ');
    std::cout << answer << std::endl;
  }
  std::_Exit(0);  // skips the departure of a thousand endpoints one by one
}

const RegisterRole role("scale-crowd", be_crowd);

}  // namespace

Arrivals::Arrivals() : descriptor_(::memfd_create("agnocast-bench arrivals", MFD_CLOEXEC)) {
  if (descriptor_ < 0 || ::ftruncate(descriptor_, sizeof(Place) * place_count) != 0)
    throw std::runtime_error("no shared memory for a hundred kilobytes");
  map();
}
Arrivals::Arrivals(int descriptor) : descriptor_(descriptor) { map(); }

Arrivals::~Arrivals() {
  ::munmap(places_, sizeof(Place) * place_count);
  ::close(descriptor_);
}

void Arrivals::map() {
  void* const memory = ::mmap(nullptr, sizeof(Place) * place_count, PROT_READ | PROT_WRITE,
                              MAP_SHARED, descriptor_, 0);
  if (memory == MAP_FAILED) throw std::runtime_error("shared memory cannot be mapped");
  places_ = static_cast<Place*>(memory);
}

void Arrivals::note(std::size_t place, std::uint64_t number) noexcept {
  Place& at = places_[place % place_count];
  at.ns.store(now_ns(), std::memory_order_relaxed);
  at.number.store(number, std::memory_order_release);
}

std::int64_t Arrivals::wait_for_last(std::size_t count, std::uint64_t number) const {
  std::int64_t last = 0;
  const auto end = Clock::now() + patience;
  for (std::size_t i = 0; i < count; ++i) {
    const Place& at = places_[i % place_count];
    while (at.number.load(std::memory_order_acquire) < number) {
      if (Clock::now() > end) return 0;
      std::this_thread::sleep_for(look_every);
    }
    last = std::max(last, at.ns.load(std::memory_order_relaxed));
  }
  return last;
}

}  // namespace agnocast::bench
