// SPDX-License-Identifier: Apache-2.0
//
// Goal: programs without any of our code understand the bridge's messages and are understood,
// member by member; and QoS mean the same as without a bridge between. Method: once with
// plain_peer, C of Cyclone DDS with types of idlc, and once with fast_peer, Fast DDS as
// rmw_fastrtps uses it.

#include <tests/integration/bridge/interoperability/peer_side.hpp>

#include <gmock/gmock.h>

#include <signal.h>

#include <chrono>
#include <map>
#include <set>
#include <thread>

namespace agnocast::test {
namespace {

using namespace std::chrono_literals;

template <class K>
class PeerOf : public Peer {};
using Kinds = testing::Types<StringKind, CloudKind, MarkersKind>;
TYPED_TEST_SUITE(PeerOf, Kinds);

constexpr std::uint64_t message_count = 10;

TYPED_TEST(PeerOf, ReceivesEveryMemberOfMessagesPublishedHere) {
  using K = TypeParam;
  this->make("reader r " + this->dds_topic() + " " + peer_name<K> + " 10");
  const auto publisher = create_publisher<typename K::M>(PlainNode(), this->topic(), 10);
  ASSERT_TRUE(this->answers("matched r", "1"));
  // The bridge has matched the publisher as well.
  ASSERT_TRUE(
      this->other_.eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  for (std::uint64_t number = 0; number < message_count; ++number) {
    SCOPED_TRACE(number);
    const std::string published = this->template publish<K>(publisher, number);
    EXPECT_EQ(this->take("r"), published);
  }
  EXPECT_EQ(this->peer_.ask("take r"), "none");
}

TYPED_TEST(PeerOf, SendsEveryMemberToSubscriptionsHere) {
  using K = TypeParam;
  this->make("writer w " + this->dds_topic() + " " + peer_name<K> + " 10");
  const auto subscription = create_subscription<typename K::M>(PlainNode(), this->topic(), 10);
  this->template meet<K>(subscription);
  for (std::uint64_t number = 0; number < message_count; ++number) {
    SCOPED_TRACE(number);
    ASSERT_EQ(this->peer_.ask("write w " + std::to_string(number)), "Success");
    const auto got = this->hear(subscription);
    ASSERT_TRUE(got);
    EXPECT_EQ(text_of<typename K::See>(*got), this->template text_of_number<K>(number));
  }
  EXPECT_FALSE(subscription->take());
}

constexpr std::uint64_t each_count = 30;

struct Class {
  const char* words;
  bool is_reliable, is_transient;
  QoS qos;
};
const std::vector<Class>& classes() {
  static const std::vector<Class> list = {
      {"best 100", false, false, QoS(100).best_effort()},
      {"reliable 100", true, false, QoS(100)},
      {"reliable transient 100", true, true, QoS(100).transient_local()},
      {"best transient 100", false, true, QoS(100).best_effort().transient_local()}};
  return list;
}
bool serves(const Class& offered, const Class& requested) {
  return (offered.is_reliable || !requested.is_reliable) &&
         (offered.is_transient || !requested.is_transient);
}
bool is_sure(const Class& offered, const Class& requested) {
  return serves(offered, requested) && offered.is_reliable && requested.is_reliable;
}
std::size_t matches_of(const Class& requested) {
  std::size_t count = 0;
  for (const Class& offered : classes()) count += serves(offered, requested);
  return count;
}

/// Returns message number `i` of the writer of class `of`.
std::uint64_t number_of(std::size_t of, std::uint64_t i) { return (of + 1) * 1000 + i; }

/// Sent before the counted messages, to see that a writer and a reader have matched on both sides.
std::uint64_t probe_of(std::size_t of) { return number_of(of, each_count); }

/// Takes from `next` until every message that may not be lost has arrived, and no other.
void expect_what_matches(Other& other, const Class& requested,
                         const std::function<std::string()>& next) {
  SCOPED_TRACE(requested.words);
  std::map<std::string, std::uint64_t> numbers;  // by the message's text
  std::size_t sure_count = 0;
  for (std::size_t of = 0; of < classes().size(); ++of) {
    if (is_sure(classes()[of], requested)) sure_count += each_count;
    for (std::uint64_t i = 0; i <= each_count; ++i) {
      String message;
      set_values<SeeString>(number_of(of, i), message);
      numbers[text_of<SeeString>(message)] = number_of(of, i);
    }
  }
  ASSERT_EQ(numbers.size(), classes().size() * (each_count + 1)) << "two messages are the same";
  std::map<std::size_t, std::vector<std::uint64_t>> got;  // by writer
  std::size_t sure = 0;
  EXPECT_TRUE(other.eventually([&] {
    for (std::string text; (text = next()) != "none";) {
      EXPECT_TRUE(numbers.contains(text)) << text;
      const std::size_t of = numbers[text] / 1000 - 1;
      if (numbers[text] == probe_of(of)) continue;
      got[of].push_back(numbers[text]);
      sure += of < classes().size() && is_sure(classes()[of], requested);
    }
    for (std::size_t of = 0; of < classes().size(); ++of) {
      if (serves(classes()[of], requested) && got[of].empty()) return false;
    }
    return sure >= sure_count;
  }));
  for (std::size_t of = 0; of < classes().size(); ++of) {
    SCOPED_TRACE("from " + std::string(classes()[of].words));
    // Once each and in order.
    EXPECT_EQ(std::adjacent_find(got[of].begin(), got[of].end(), std::greater_equal<>()),
              got[of].end());
    if (is_sure(classes()[of], requested)) {
      EXPECT_EQ(got[of].size(), each_count);
    }
    EXPECT_EQ(got[of].empty(), !serves(classes()[of], requested));
  }
}

TEST_F(Peer, ReceivesMatchingClassesOfOneTopicOnceAndInOrder) {
  std::vector<Publisher<String>::SharedPtr> publishers;
  for (const Class& one : classes())
    publishers.push_back(create_publisher<String>(PlainNode(), topic(), one.qos));
  for (std::size_t i = 0; i < classes().size(); ++i)
    make("reader r" + std::to_string(i) + " " + dds_topic() + " String " + classes()[i].words);
  for (std::size_t i = 0; i < classes().size(); ++i)
    ASSERT_TRUE(answers("matched r" + std::to_string(i), std::to_string(matches_of(classes()[i]))));
  std::map<std::string, std::size_t> probes;
  std::set<std::pair<std::size_t, std::size_t>> met;
  std::size_t pairs = 0;
  for (const Class& requested : classes()) pairs += matches_of(requested);
  ASSERT_TRUE(other_.eventually([&] {
    for (std::size_t of = 0; of < publishers.size(); ++of)
      probes[publish<StringKind>(publishers[of], probe_of(of))] = of;
    for (std::size_t r = 0; r < classes().size(); ++r)
      for (std::string text; (text = peer_.ask("take r" + std::to_string(r))) != "none";)
        met.emplace(probes.at(text), r);
    return met.size() == pairs;
  }));
  for (std::uint64_t i = 0; i < each_count; ++i)
    for (std::size_t of = 0; of < publishers.size(); ++of)
      publish<StringKind>(publishers[of], number_of(of, i));
  for (std::size_t r = 0; r < classes().size(); ++r)
    expect_what_matches(other_, classes()[r],
                        [&] { return peer_.ask("take r" + std::to_string(r)); });
}

TEST_F(Peer, SendsToMatchingClassesOfOneTopicHereOnceAndInOrder) {
  std::vector<Subscription<String>::SharedPtr> subscriptions;
  for (const Class& one : classes())
    subscriptions.push_back(create_subscription<String>(PlainNode(), topic(), one.qos));
  for (std::size_t i = 0; i < classes().size(); ++i)
    make("writer w" + std::to_string(i) + " " + dds_topic() + " String " + classes()[i].words);
  std::map<std::string, std::size_t> probes;
  std::set<std::pair<std::size_t, std::size_t>> met;
  std::size_t pairs = 0;
  for (const Class& requested : classes()) pairs += matches_of(requested);
  ASSERT_TRUE(other_.eventually([&] {
    for (std::size_t of = 0; of < classes().size(); ++of) {
      probes[text_of_number<StringKind>(probe_of(of))] = of;
      EXPECT_EQ(peer_.ask("write w" + std::to_string(of) + " " + std::to_string(probe_of(of))),
                "Success");
    }
    for (std::size_t s = 0; s < classes().size(); ++s)
      while (const auto message = subscriptions[s]->take())
        met.emplace(probes.at(text_of<SeeString>(*message)), s);
    return met.size() == pairs;
  }));
  for (std::uint64_t i = 0; i < each_count; ++i)
    for (std::size_t of = 0; of < classes().size(); ++of)
      ASSERT_EQ(peer_.ask("write w" + std::to_string(of) + " " + std::to_string(number_of(of, i))),
                "Success");
  for (std::size_t s = 0; s < classes().size(); ++s)
    expect_what_matches(other_, classes()[s], [&]() -> std::string {
      const auto message = subscriptions[s]->take();
      return message ? text_of<SeeString>(*message) : "none";
    });
}

TEST_F(Peer, LateReadersGetTheHistoryIfOfferedAndRequested) {
  const auto publisher = create_publisher<String>(PlainNode(), topic(), QoS(3).transient_local());
  make("reader early " + dds_topic() + " String transient 10");
  std::vector<std::string> texts;
  ASSERT_TRUE(answers("matched early", "1"));
  for (std::uint64_t i = 0; i < 6; ++i) {
    texts.push_back(publish<StringKind>(publisher, i));
    EXPECT_EQ(take("early"), texts.back());
  }
  make("reader late " + dds_topic() + " String transient 10");
  for (std::size_t i = 3; i < 6; ++i) EXPECT_EQ(take("late"), texts[i]);
  EXPECT_EQ(peer_.ask("take late"), "none");
}

TEST_F(Peer, LateSubscriptionsGetTheHistoryOnlyIfOfferedAndRequested) {
  // The depth that counts for Fast DDS here, which does not announce it.
  constexpr std::uint64_t depth = 10, count = 15;
  make("writer w " + dds_topic() + " String transient " + std::to_string(depth));
  const auto early = create_subscription<String>(PlainNode(), topic(), QoS(100).transient_local());
  ASSERT_TRUE(answers("matched w", "1"));
  for (std::uint64_t i = 0; i < count; ++i) {
    ASSERT_EQ(peer_.ask("write w " + std::to_string(i)), "Success");
    const auto got = this->hear(early);
    ASSERT_TRUE(got);
    EXPECT_EQ(text_of<SeeString>(*got), text_of_number<StringKind>(i));
  }
  const auto late = create_subscription<String>(PlainNode(), topic(), QoS(100).transient_local());
  const auto fresh = create_subscription<String>(PlainNode(), topic(), QoS(10));
  for (std::uint64_t i = count - depth; i < count; ++i) {
    const auto got = this->hear(late);
    ASSERT_TRUE(got);
    EXPECT_EQ(text_of<SeeString>(*got), text_of_number<StringKind>(i));
  }
  // It matches the bridge's publisher in its own time.
  std::set<std::string> later;
  std::string first;
  EXPECT_TRUE(other_.eventually([&] {
    const std::uint64_t number = count + later.size();
    later.insert(text_of_number<StringKind>(number));
    EXPECT_EQ(peer_.ask("write w " + std::to_string(number)), "Success");
    const auto got = fresh->take();
    if (got) first = text_of<SeeString>(*got);
    return bool(got);
  }));
  EXPECT_TRUE(later.contains(first)) << first;
}

TEST_F(Peer, ThatIsStoppedBlocksAKeepAllPublisherAndNoOtherAndLosesNothing) {
  // Together far more than a writer may have unacknowledged and than may wait for it.
  constexpr std::uint64_t count = 1'000;
  constexpr std::size_t letters = 10'000;
  make("reader r " + dds_topic() + " String all");
  const auto publisher = create_publisher<String>(PlainNode(), topic(), QoS(1).keep_all(50));
  ASSERT_TRUE(answers("matched r", "1"));
  ASSERT_TRUE(other_.eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  DdsReader& beside = other_.reads<String>(dds_topic() + "_beside", {});
  const auto free = create_publisher<String>(PlainNode(), topic() + "_beside", QoS(1).keep_all(50));
  ASSERT_TRUE(other_.eventually([&] { return is_out(beside, *free); }));
  std::uint64_t sent = 0;
  const auto publish_one = [&] {
    auto loan = publisher->borrow_loaned_message();
    loan->data = letters_of(sent, letters);
    const PublishResult result = publisher->publish(std::move(loan));
    EXPECT_TRUE(result || result.code == Errc::would_block);
    if (result) ++sent;
    return static_cast<bool>(result);
  };
  ASSERT_EQ(::kill(peer_.pid(), SIGSTOP), 0);
  // No message moves for five times as long as a write waits for its readers.
  auto moved = std::chrono::steady_clock::now();
  while (sent < count && std::chrono::steady_clock::now() - moved < 500ms) {
    if (publish_one()) moved = std::chrono::steady_clock::now();
    std::this_thread::sleep_for(1ms);
  }
  EXPECT_LT(sent, count) << "it never blocked";
  for (std::uint64_t number = 0; number < 20; ++number) {
    const std::string text = publish<StringKind>(free, number);
    const auto got = other_.take<String>(beside);
    ASSERT_NE(got, nullptr) << number;
    EXPECT_EQ(text_of<SeeString>(*got), text);
  }
  ASSERT_EQ(::kill(peer_.pid(), SIGCONT), 0);
  for (std::uint64_t number = 0; number < count; ++number) {
    while (sent < count && publish_one()) {
    }
    ASSERT_TRUE(take("r") == '"' + letters_of(number, letters) + "\" ") << "message " << number;
  }
  EXPECT_EQ(peer_.ask("take r"), "none");
}

TEST_F(Peer, ReceivesAllOfAKeepAllPublisherInOrderAlthoughItReadsSlowly) {
  // Together far more than a writer may have unacknowledged.
  constexpr std::uint64_t count = 2'000;
  constexpr std::size_t letters = 10'000;
  make("reader r " + dds_topic() + " String all");
  const auto publisher = create_publisher<String>(PlainNode(), topic(), QoS(1).keep_all(50));
  ASSERT_TRUE(answers("matched r", "1"));
  ASSERT_TRUE(other_.eventually([&] { return publisher->get_linked_subscription_count() == 1; }));
  std::uint64_t sent = 0, got = 0;
  const auto publish_some = [&] {
    for (; sent < count; ++sent) {
      auto loan = publisher->borrow_loaned_message();
      loan->data = letters_of(sent, letters);
      const PublishResult result = publisher->publish(std::move(loan));
      if (result.code == Errc::would_block) return;
      ASSERT_TRUE(result);
    }
  };
  const auto end = std::chrono::steady_clock::now() + patience;
  while (got < count && std::chrono::steady_clock::now() < end) {
    publish_some();
    const std::string text = peer_.ask("take r");
    if (text == "none") continue;
    ASSERT_TRUE(text == '"' + letters_of(got, letters) + "\" ") << "message " << got;
    ++got;
  }
  EXPECT_EQ(got, count);
  EXPECT_EQ(peer_.ask("take r"), "none");
}

}  // namespace
}  // namespace agnocast::test
