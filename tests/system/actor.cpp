// SPDX-License-Identifier: Apache-2.0
//
// A node as users write one, steered line by line on its standard input; answers each line with
// one line. Several publishers and subscriptions, each under a number that the harness assigns.
// Uses only the public interface; with the heap hook preloaded it can publish. "Intact" means
// compared member by member with a newly made message (tests/system/specimen.hpp).
//
//   seed N
//   pub ID TOPIC QOS · unpub ID          QOS: depth and letters, e.g. 10tba
//   sub ID TOPIC QOS QUOTA · unsub ID         t transient local, b best effort, a keep-all
//   publish ID COUNT BYTES               → COMMITTED [why not more]
//   take ID                             → none LOST | PUBLISHER NUMBER SEQUENCE LOST | bad …  held
//   release ID POSITION                  → ok | bad …           a held message, compared once more
//   release_ended                        → ok | bad …           the same of ended subscriptions
//   matched ID                           → subscriptions that this publisher has
//   sync                                 → ok     everything announced so far has been handled
//   run_pub ID COUNT SEED PROGRESS       → free run: COMMITTED
//   run_sub ID DEPTH PUBLISHERS SEED PROGRESS → free run: verdict (tests/system/free_run.hpp)
//   live                                 → bytes allocated in the shared heap, and its frontier

#include <tests/support/processes/actor.hpp>
#include <tests/system/free_run.hpp>
#include <tests/system/specimen.hpp>

#include <agnocast/abi/heaphook.h>
#include <agnocast/agnocast.hpp>

#include <dlfcn.h>
#include <unistd.h>

#include <deque>
#include <iostream>
#include <map>
#include <sstream>
#include <string>
#include <utility>

namespace agnocast::test {
namespace {

class Actor {
 public:
  std::string execute(std::istringstream& line) {
    std::string what;
    line >> what;
    if (what == "sync") return sync();
    if (what == "live") return live();
    if (what == "release_ended") return release_ended();
    std::uint64_t id = 0;
    line >> id;
    if (what == "seed") return seed_ = id, "ok";
    if (what == "pub") return advertise(id, line);
    if (what == "sub") return subscribe(id, line);
    if (what == "publish") return publish(id, line);
    if (what == "take") return take(subscriptions_.at(id));
    if (what == "release") return release(subscriptions_.at(id), line);
    if (what == "matched")
      return std::to_string(publishers_.at(id).publisher->get_linked_subscription_count());
    if (what == "unpub") return publishers_.erase(id), "ok";
    if (what == "unsub") return unsubscribe(id);
    if (what == "run_pub") return run_publisher(id, line);
    if (what == "run_sub") return run_subscription(subscriptions_.at(id), line);
    return "bad command " + what;
  }

 private:
  struct OwnPublisher {
    Publisher<Specimen>::SharedPtr publisher;
    std::uint64_t number = 0;
  };
  struct Held {
    ipc_shared_ptr<const Specimen> message;
    SpecimenName name;
  };
  struct OwnSubscription {
    Subscription<Specimen>::SharedPtr subscription;
    std::deque<Held> held;
  };

  std::string advertise(std::uint64_t id, std::istringstream& line) {
    std::string topic, qos;
    line >> topic >> qos;
    publishers_[id] = {create_publisher<Specimen>(node_, topic, qos_from_letters(qos)), 0};
    return "ok";
  }

  std::string subscribe(std::uint64_t id, std::istringstream& line) {
    std::string topic, qos;
    std::size_t quota = 0;
    line >> topic >> qos >> quota;
    auto made = try_create_subscription<Specimen>(node_, topic, qos_from_letters(qos),
                                                  SubscriptionOptions().hold_quota(quota));
    if (!made) throw Error(made.error());
    subscriptions_[id] = {std::move(*made), {}};
    return "ok";
  }

  Errc publish_next(std::uint64_t id, OwnPublisher& own, std::uint64_t bytes) {
    auto loan = own.publisher->borrow_loaned_message();
    SpecimenMaker::fill(*loan, seed_, {id, own.number + 1, bytes});
    const PublishResult result = own.publisher->publish(std::move(loan));
    if (result && result.adopted_bytes != 0) throw std::runtime_error("it was copied");
    if (result) ++own.number;
    return result.code;
  }

  std::string publish(std::uint64_t id, std::istringstream& line) {
    std::uint64_t count = 0, bytes = 0;
    line >> count >> bytes;
    for (std::uint64_t i = 0; i < count; ++i) {
      if (const Errc code = publish_next(id, publishers_.at(id), bytes); code != Errc::ok)
        return std::to_string(i) + " " + sentence_of(code);
    }
    return std::to_string(count);
  }

  std::string take(OwnSubscription& own) {
    auto message = own.subscription->take();
    const std::string lost = std::to_string(own.subscription->get_lost_count());
    if (!message) return "none " + lost;
    const SpecimenName name = SpecimenMaker::name_of(*message);
    if (!SpecimenMaker::is_intact(*message, seed_, name)) return "bad content";
    const std::uint64_t sequence = message.info().sequence;
    own.held.push_back({std::move(message), name});
    return std::to_string(name.publisher) + " " + std::to_string(name.number) + " " +
           std::to_string(sequence) + " " + lost;
  }

  std::string release(OwnSubscription& own, std::istringstream& line) {
    std::size_t position = 0;
    line >> position;
    const auto held = own.held.begin() + static_cast<std::ptrdiff_t>(position);
    const bool intact = SpecimenMaker::is_intact(*held->message, seed_, held->name);
    own.held.erase(held);
    return intact ? "ok" : "bad content";
  }

  std::string unsubscribe(std::uint64_t id) {
    for (Held& held : subscriptions_.at(id).held) outliving_.push_back(std::move(held));
    subscriptions_.erase(id);
    return "ok";
  }

  std::string release_ended() {
    bool intact = true;
    for (const Held& held : outliving_)
      intact = intact && SpecimenMaker::is_intact(*held.message, seed_, held.name);
    outliving_.clear();
    return intact ? "ok" : "bad content";
  }

  // The daemon's answer comes after everything that it announced before.
  std::string sync() {
    create_subscription<Specimen>(node_, "/sync" + std::to_string(::getpid()), QoS(1));
    return "ok";
  }

  static std::string live() {
    using Find = const agnocast_heaphook_table* (*)();
    const auto find = reinterpret_cast<Find>(::dlsym(RTLD_DEFAULT, "agnocast_heaphook"));
    if (find == nullptr) return "0 0";
    agnocast_heaphook_usage usage{};
    find()->usage(&usage);
    return std::to_string(usage.live_bytes) + " " + std::to_string(usage.frontier_bytes);
  }

  std::string run_publisher(std::uint64_t id, std::istringstream& line) {
    std::uint64_t count = 0, seed = 0;
    std::string path;
    line >> count >> seed >> path;
    Progress::Publisher& progress = Progress::at(path).publisher[id];
    OwnPublisher& own = publishers_.at(id);
    Random random(seed);
    while (own.number < count) {
      progress.attempted.store(own.number + 1);
      const Errc code = publish_next(id, own, 0);
      if (code != Errc::ok && code != Errc::would_block)
        return "bad " + std::string(sentence_of(code));
      progress.committed.store(own.number);
      if (code == Errc::would_block || random.chance(20))
        ::usleep(static_cast<useconds_t>(random.below(300)));
    }
    return std::to_string(own.number);
  }

  std::string run_subscription(OwnSubscription& own, std::istringstream& line) {
    std::uint64_t depth = 0, publishers = 0, seed = 0;
    std::string path;
    line >> depth >> publishers >> seed >> path;
    const Progress& progress = Progress::at(path);
    FreeRunJudge judge(depth, publishers);
    Random random(seed);
    for (;;) {
      const bool is_last_look = progress.stop.load() != 0;
      auto message = own.subscription->take();
      if (!message) {
        judge.found_nothing();
        if (is_last_look) break;
        ::usleep(static_cast<useconds_t>(random.below(500)));
        continue;
      }
      const SpecimenName name = SpecimenMaker::name_of(*message);
      judge.took(name.publisher, name.number, own.subscription->get_lost_count(),
                 SpecimenMaker::is_intact(*message, seed_, name));
      own.held.push_back({std::move(message), name});
      while (own.held.size() > random.below(8)) {
        if (!SpecimenMaker::is_intact(*own.held.front().message, seed_, own.held.front().name))
          return "bad held content";
        own.held.pop_front();
      }
      if (random.chance(2)) ::usleep(static_cast<useconds_t>(random.below(5000)));  // lags
    }
    own.held.clear();
    return judge.verdict();
  }

  ActorNode node_{"actor"};
  std::uint64_t seed_ = 0;
  std::map<std::uint64_t, OwnPublisher> publishers_;
  std::map<std::uint64_t, OwnSubscription> subscriptions_;
  std::deque<Held> outliving_;  // outliving their subscriptions
};

}  // namespace
}  // namespace agnocast::test

int main() {
  agnocast::test::Actor actor;
  std::string text;
  while (std::getline(std::cin, text)) {
    std::istringstream line(text);
    std::string answer;
    try {
      answer = actor.execute(line);
    } catch (const std::exception& error) {
      answer = std::string("bad ") + error.what();
    }
    std::cout << answer << std::endl;
  }
  return 0;
}
