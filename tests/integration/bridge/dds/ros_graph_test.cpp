// SPDX-License-Identifier: Apache-2.0
//
// Nodes as ROS 2 announces them: the bytes of a recorded message, both layouts between two
// processes, and lies.

#include <tests/integration/bridge/dds/dds_domain.hpp>

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>

namespace agnocast::test {
namespace {

using bridge::Guid;
using bridge::GuidLayout;
using bridge::RosEntities;
using bridge::RosGraph;
using bridge::RosNode;

constexpr int answer_s = 90;
constexpr auto entities_type = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";

Guid guid_of(const std::string& hex) {
  Guid guid;
  const Bytes bytes = bytes_of(hex.substr(0, 32));
  std::memcpy(guid.bytes.data(), bytes.data(), bytes.size());
  return guid;
}
Guid guid_of(int number) {
  Guid guid;
  guid.bytes.fill(std::uint8_t(number));
  return guid;
}
std::optional<RosEntities> read(const Bytes& bytes) {
  const std::span<const std::byte> piece(bytes);
  return bridge::read_entities({&piece, 1});
}
std::string hex_of(const Bytes& bytes) {
  std::string hex;
  for (const std::byte byte : bytes) {
    constexpr char digits[] = "0123456789abcdef";
    hex += digits[std::to_integer<unsigned>(byte) >> 4];
    hex += digits[std::to_integer<unsigned>(byte) & 15];
  }
  return hex;
}

RosEntities example(GuidLayout layout) {
  RosEntities entities{guid_of(1), {}, layout};
  entities.nodes.push_back({"/", "talker", {guid_of(2), guid_of(3)}, {guid_of(4)}});
  entities.nodes.push_back({"/deep/name_space", "n0", {}, {}});
  return entities;
}

/// Returns the value of `key` in a recorded sample: text between quotation marks.
std::string text_in(const std::string& json, const std::string& key) {
  const std::size_t at = json.find("\"" + key + "\": \"");
  if (at == std::string::npos) return {};
  const std::size_t begin = at + key.size() + 5;
  return json.substr(begin, json.find('"', begin) - begin);
}
/// Returns the content of a recorded sample; empty without a folder of them.
std::string recorded(const std::string& name) {
  const char* const folder = std::getenv("AGNOCAST_GOLDEN_CDR_DIR");
  if (folder == nullptr || !std::filesystem::is_directory(folder)) return {};
  std::ifstream file(std::filesystem::path(folder) / name);
  EXPECT_TRUE(file) << folder << " has no " << name;
  return {std::istreambuf_iterator<char>(file), {}};
}
constexpr const char* no_samples = "AGNOCAST_GOLDEN_CDR_DIR names no folder of samples";

TEST(RosEntities, EqualTheRecordedBytesOfRos2) {
  const std::string json = recorded("wire_ros_discovery_info.json");
  if (json.empty()) GTEST_SKIP() << no_samples;
  const std::string prefix = "01104754e7a7e61b2adf6c55";
  const auto guids = [&](const char* kind, std::initializer_list<const char*> numbers) {
    std::vector<Guid> of;
    for (const char* number : numbers) of.push_back(guid_of(prefix + "0000" + number + kind));
    return of;
  };
  RosEntities entities{guid_of(text_in(json, "gid")), {}, GuidLayout::humble};
  ASSERT_EQ(entities.participant, guid_of(prefix + "000001c1"));
  entities.nodes.push_back({"/scratch", "n_sub_string",
                            guids("04", {"08", "0a", "0c", "0e", "10", "12", "14", "15"}),
                            guids("03", {"06", "07", "09", "0b", "0d", "0f", "11", "13"})});
  EXPECT_EQ(hex_of(write_entities(entities)), text_in(json, "payload_hex"));
  EXPECT_EQ(read(bytes_of(text_in(json, "payload_hex"))), entities);
}

TEST(RosEntities, DescribeServicesAsRecordedFromRos2) {
  const std::string json = recorded("wire_sedp_service_client_writer.json");
  if (json.empty()) GTEST_SKIP() << no_samples;
  const std::string text = bridge::service_user_data(bridge::ServiceRole::client,
                                                     guid_of("01105bf7cad71d3b7cb5cb3a00000007"));
  const Bytes bytes(reinterpret_cast<const std::byte*>(text.data()),
                    reinterpret_cast<const std::byte*>(text.data()) + text.size());
  EXPECT_NE(json.find(hex_of(bytes)), std::string::npos) << text;
}

TEST(RosEntities, AreReadAsWrittenInBothLayoutsAndWithTrailingBytes) {
  for (const GuidLayout layout : {GuidLayout::humble, GuidLayout::iron}) {
    const RosEntities entities = example(layout);
    Bytes bytes = write_entities(entities);
    EXPECT_EQ(bytes.size() % 4, 0u);
    EXPECT_EQ(read(bytes), entities);
    for (int i = 0; i < 8; ++i) bytes.push_back(std::byte{0xee});
    EXPECT_EQ(read(bytes), entities);
    bytes.push_back(std::byte{0});
    EXPECT_FALSE(read(bytes));

    const RosEntities nobody{guid_of(9), {}, layout};
    EXPECT_EQ(read(write_entities(nobody)), nobody);
  }
}

TEST(RosEntities, AreReadFromAnyTwoPiecesAndFromBigEndianBytes) {
  const RosEntities entities = example(GuidLayout::iron);
  const Bytes bytes = write_entities(entities);
  for (std::size_t cut = 0; cut <= bytes.size(); ++cut) {
    const std::span<const std::byte> all(bytes);
    const std::span<const std::byte> pieces[] = {all.first(cut), all.subspan(cut)};
    EXPECT_EQ(bridge::read_entities(pieces), entities) << cut;
  }
  const Bytes big = bytes_of("00000000" + std::string(32, '1') +
                             "00000001"
                             "00000002"
                             "2f000000"
                             "00000002"
                             "61000000"
                             "00000000"
                             "00000000");
  const auto read_back = read(big);
  ASSERT_TRUE(read_back);
  EXPECT_EQ(read_back->nodes, (std::vector<RosNode>{{"/", "a", {}, {}}}));
}

TEST(RosEntities, AreRefusedWhereverTheyAreTruncatedOrCountTooMuch) {
  for (const GuidLayout layout : {GuidLayout::humble, GuidLayout::iron}) {
    const Bytes whole = write_entities(example(layout));
    for (std::size_t size = 0; size < whole.size(); ++size)
      EXPECT_NE(read(Bytes(whole.begin(), whole.begin() + std::ptrdiff_t(size))), example(layout));
    // Any four bytes as a false count: nothing is allocated for it, and the result differs from
    // before.
    for (std::size_t at = 4; at + 4 <= whole.size(); at += 4) {
      Bytes lie = whole;
      std::fill_n(lie.begin() + std::ptrdiff_t(at), 4, std::byte{0x7f});
      EXPECT_NE(read(lie), example(layout)) << at;
    }
  }
  // Names that ROS 2 does not allow, which terminals would obey; a name without its end.
  for (const std::string name : {"a b", "\x1b[2J", "", "a/b"}) {
    RosEntities entities{guid_of(1), {{"/", name, {}, {}}}, GuidLayout::iron};
    EXPECT_FALSE(read(write_entities(entities))) << name;
    entities.nodes = {{"/" + name + "/", "a", {}, {}}};
    EXPECT_FALSE(read(write_entities(entities))) << name;
  }
  for (const int encapsulation : {2, 3, 6, 7}) {
    Bytes other = write_entities(example(GuidLayout::humble));
    other[1] = std::byte(encapsulation);
    EXPECT_FALSE(read(other)) << encapsulation;
  }
  Bytes large = write_entities(example(GuidLayout::humble));
  large.resize((std::size_t{1} << 20) + 4);
  EXPECT_FALSE(read(large));
}

std::unique_ptr<RosGraph> graph_of(DdsParticipant& participant, RosGraph::Speak speak) {
  return std::move(RosGraph::create(participant, speak).value());
}

TEST(RosGraph, TwoProcessesSeeEachOthersNodesInBothLayouts) {
  for (const std::string layout : {"humble", "iron"}) {
    SCOPED_TRACE(layout);
    const Domain domain;
    const auto participant = domain.participant();
    const auto graph = graph_of(*participant, RosGraph::Speak::detect);
    EXPECT_EQ(graph->layout(), GuidLayout::humble);
    const auto writer = std::move(participant->create_writer("rt/a", "t", {}).value());
    ASSERT_TRUE(graph->set_nodes({{"/here", "bridge", {}, {writer->guid(), writer->guid()}}}));
    const auto peer = domain.peer("1 s");
    ASSERT_EQ(peer->ask("speak " + layout, answer_s), "made");
    ASSERT_EQ(peer->ask("nodes talker"), "said");
    ASSERT_TRUE(until(*participant, [&] {
      (void)graph->update();
      return graph->others().size() == 1;
    }));
    const RosEntities& other = graph->others().begin()->second;
    ASSERT_EQ(other.nodes.size(), 1u);
    EXPECT_EQ(other.nodes[0].name, "talker");
    EXPECT_EQ(other.nodes[0].name_space, "/peer");
    EXPECT_EQ(other.nodes[0].writers, std::vector<Guid>{other.participant});
    EXPECT_TRUE(participant->remotes().contains(other.participant));
    // After the change the others' layout is used for everything announced before in Humble's.
    EXPECT_EQ(graph->layout() == GuidLayout::iron, layout == "iron");
    EXPECT_TRUE(peer->eventually("others bridge", "/here 0 readers 2 writers " + layout));

    ASSERT_TRUE(graph->set_nodes({{"/here", "renamed", {writer->guid()}, {}}}));
    EXPECT_EQ(peer->ask("others renamed", answer_s), "/here 1 readers 0 writers " + layout);

    peer->kill();
    EXPECT_TRUE(until(*participant, [&] {
      (void)graph->update();
      return graph->others().empty();
    }));
    EXPECT_EQ(graph->layout(), GuidLayout::humble);
    EXPECT_EQ(graph->refused(), 0u);
  }
}

TEST(RosGraph, UsesTheLayoutOfMostOthersIgnoringBridges) {
  const Domain domain;
  const auto participant = domain.participant();
  const auto graph = graph_of(*participant, RosGraph::Speak::detect);
  const auto sees = [&](std::size_t others) {
    return until(*participant, [&] {
      (void)graph->update();
      return graph->others().size() == others;
    });
  };
  const auto peer_with = [&](const std::string& layout, const std::string& nodes) {
    auto peer = domain.peer();
    EXPECT_EQ(peer->ask("speak " + layout, answer_s), "made");
    EXPECT_EQ(peer->ask("nodes " + nodes, answer_s), "said");
    return peer;
  };
  const auto bridge = peer_with("iron", "_agnocast_bridge");
  const auto another = peer_with("iron", "_agnocast_bridge");
  ASSERT_TRUE(sees(2));
  EXPECT_EQ(graph->layout(), GuidLayout::humble);
  const auto talker = peer_with("iron", "talker");
  ASSERT_TRUE(sees(3));
  EXPECT_EQ(graph->layout(), GuidLayout::iron);
  const auto listener = peer_with("humble", "listener");
  ASSERT_TRUE(sees(4));
  EXPECT_EQ(graph->layout(), GuidLayout::humble)
      << "as many of each, and only bridges make it more";
}

TEST(RosGraph, CountsMalformedMessagesAndImpostors) {
  const Domain domain;
  const auto participant = domain.participant();
  const auto graph = graph_of(*participant, RosGraph::Speak::humble);
  const auto peer = domain.peer();
  const std::string topic = "ros_discovery_info";
  ASSERT_EQ(peer->ask("writer " + topic + " " + entities_type + " reliable transient 1"), "made");
  const auto refused = [&](std::uint64_t count) {
    return until(*participant, [&] {
      (void)graph->update();
      return graph->refused() == count;
    });
  };
  ASSERT_EQ(peer->ask("write-hex " + topic + " 00010000ff", answer_s), "sent");
  EXPECT_TRUE(refused(1));
  ASSERT_EQ(
      peer->ask("write-hex " + topic + " " + hex_of(write_entities(example(GuidLayout::iron))),
                answer_s),
      "sent");
  EXPECT_TRUE(refused(2));
  EXPECT_TRUE(graph->others().empty());
}

}  // namespace
}  // namespace agnocast::test
