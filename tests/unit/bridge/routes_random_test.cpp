// SPDX-License-Identifier: Apache-2.0
//
// Goal: whatever endpoints both sides have, each message goes over once, or nobody matched it.
// Method: 500 random situations, judged by the rules of DDS.

#include <tests/unit/bridge/routes_fixture.hpp>

namespace agnocast::bridge {
namespace {

bool matches(bool offers_reliable, bool offers_history, bool wants_reliable, bool wants_history) {
  return (offers_reliable || !wants_reliable) && (offers_history || !wants_history);
}

// Long because each relation between the parts of a plan is checked, one after the other.
TEST_F(Routes, CarryEveryMessageOnceInAnySituation) {
  std::mt19937 random(7);
  const auto flip = [&] { return random() % 2 == 0; };
  for (int round = 0; round < 500; ++round) {
    locals_.clear();
    remotes_.clear();
    const std::vector<std::string> topics{"/a", "/b"};
    for (auto i = random() % 6; i > 0; --i) {
      QoS qos(1 + random() % 20);
      if (flip()) qos.best_effort();
      if (flip()) qos.transient_local();
      local(flip() ? EndpointKind::publisher : EndpointKind::subscription, topics[random() % 2],
            qos);
    }
    for (auto i = random() % 6; i > 0; --i)
      remote(flip() ? Remote::Kind::writer : Remote::Kind::reader, "rt" + topics[random() % 2],
             flip(), flip());
    const Plan now = plan();
    for (const EndpointInfo& endpoint : locals_) {
      const QosClass own{endpoint.qos.is_reliable(), endpoint.qos.is_transient_local()};
      for (const auto& [guid, other] : remotes_) {
        if (other.topic != "rt" + endpoint.topic) continue;
        const QosClass theirs{other.qos.reliable, other.qos.transient_local};
        if (endpoint.kind == EndpointKind::publisher && other.kind == Remote::Kind::reader) {
          if (!matches(own.reliable, own.transient_local, theirs.reliable, theirs.transient_local))
            continue;
          // Its messages come only through the local reader of its QoS, to its own DDS writer.
          ASSERT_TRUE(now.dds_writers.contains(endpoint.generation));
          const ReaderKey local_reader{
              {{endpoint.topic, endpoint.type}, own}, endpoint.qos.depth(), false};
          EXPECT_EQ(now.dds_writers.at(endpoint.generation).local_reader, local_reader);
          EXPECT_TRUE(now.local_readers.contains(local_reader));
        }
        if (endpoint.kind == EndpointKind::subscription && other.kind == Remote::Kind::writer &&
            matches(theirs.reliable, theirs.transient_local, own.reliable, own.transient_local)) {
          ASSERT_TRUE(now.remote_publishers.contains(guid));
          EXPECT_EQ(now.remote_publishers.at(guid).qos_class, theirs);
          // One DDS reader matches the writer and requests all that the subscription does.
          const QosClass read = now.remote_publishers.at(guid).dds_reader;
          EXPECT_TRUE(now.dds_readers.contains({{endpoint.topic, endpoint.type}, read}));
          EXPECT_TRUE(matches(theirs.reliable, theirs.transient_local, read.reliable,
                              read.transient_local));
          EXPECT_TRUE(
              matches(read.reliable, read.transient_local, own.reliable, own.transient_local));
        }
      }
    }
    // Every part of the plan serves some endpoint.
    for (const auto& [generation, dds_writer] : now.dds_writers)
      EXPECT_TRUE(now.local_readers.contains(dds_writer.local_reader));
    for (const ReaderKey& local_reader : now.local_readers)
      EXPECT_TRUE(std::any_of(
          now.dds_writers.begin(), now.dds_writers.end(),
          [&](const auto& dds_writer) { return dds_writer.second.local_reader == local_reader; }));
    for (const auto& [reader_key, dds_reader] : now.dds_readers) {
      const auto& key = reader_key;  // clang 14 captures no structured binding
      EXPECT_FALSE(dds_reader.nodes.empty());
      const bool is_written =
          std::any_of(now.remote_publishers.begin(), now.remote_publishers.end(),
                      [&](const auto& remote_publisher) {
                        return remote_publisher.second.key == key.key &&
                               remote_publisher.second.dds_reader == key.qos_class;
                      });
      const bool is_wanted = std::any_of(locals_.begin(), locals_.end(), [&](const auto& local) {
        return local.kind == EndpointKind::subscription && local.topic == key.key.topic &&
               QosClass{local.qos.is_reliable(), local.qos.is_transient_local()} == key.qos_class;
      });
      EXPECT_TRUE(is_written || is_wanted);
    }
    for (const auto& [guid, remote_publisher] : now.remote_publishers)
      EXPECT_TRUE(now.dds_readers.contains({remote_publisher.key, remote_publisher.dds_reader}));
    if (HasFailure()) return;
  }
}

}  // namespace
}  // namespace agnocast::bridge
