// SPDX-License-Identifier: Apache-2.0
//
// Goal: the bridge understands what ROS 2 processes sent: payloads of DATA submessages with their
// padding, the header of a request, node discovery, and the names in discovery. Method: packets
// recorded from rmw_cyclonedds and rmw_fastrtps, with the schemas of the other samples.

#include <bridge/cdr/cdr.hpp>
#include <bridge/dds/names.hpp>
#include <tests/support/messages/random_message.hpp>
#include <tests/unit/bridge/golden_sample.hpp>
#include <tests/unit/bridge/pieces.hpp>

#include <gtest/gtest.h>

#include <algorithm>

namespace agnocast::bridge {
namespace {

using test::Bytes;
using test::Pieces;
using test::Sample;

class GoldenWire : public testing::Test {
 protected:
  void SetUp() override {
    if (test::recorded_samples().empty())
      GTEST_SKIP() << "AGNOCAST_GOLDEN_CDR_DIR names no folder of recorded packets";
  }
};

/// Returns the schema of `type` from the first sample that has it.
test::Schema schema_of(const std::string& type) {
  for (const Sample& sample : test::samples_with("schema")) {
    if (sample.text("ros_type") == type) return sample.schema();
  }
  return {};
}

constexpr const char* discovery_topic = "ros_discovery_info";

nlohmann::json gid_of(const std::string& hex) {
  nlohmann::json data = nlohmann::json::array();
  for (const std::byte byte : test::bytes_of_hex(hex)) data.push_back(std::to_integer<int>(byte));
  return {{"data", data}};
}

/// Returns the value with the names of the schema: samples of node discovery abbreviate them.
nlohmann::json value_of(const Sample& sample) {
  nlohmann::json value = sample.json.at("value");
  if (!value.contains("nodes")) return value;
  const auto gids_of = [](const nlohmann::json& list) {
    nlohmann::json gids = nlohmann::json::array();
    for (const auto& hex : list) gids.push_back(gid_of(hex.get<std::string>()));
    return gids;
  };
  nlohmann::json nodes = nlohmann::json::array();
  for (const auto& node : value.at("nodes")) {
    nodes.push_back({{"node_namespace", node.at("namespace")},
                     {"node_name", node.at("name")},
                     {"reader_gid_seq", gids_of(node.at("reader_gids"))},
                     {"writer_gid_seq", gids_of(node.at("writer_gids"))}});
  }
  return {{"gid", gid_of(value.at("gid").get<std::string>())}, {"node_entities_info_seq", nodes}};
}

TEST_F(GoldenWire, PayloadsAreReadAndRewrittenToTheSameBytes) {
  const std::vector<Sample> samples = test::samples_with("payload_hex");
  ASSERT_FALSE(samples.empty());
  for (const Sample& sample : samples) {
    SCOPED_TRACE(sample.file);
    const auto name = ros_type_of(sample.text("dds_type"));
    ASSERT_TRUE(name);
    const IntrospectedType type(test::members_of_schema(schema_of(*name), *name));
    const CdrType cdr = CdrType::of(type.members()).value();
    const Bytes payload = test::bytes_of_hex(sample.text("payload_hex"));
    const OwnedGenericMessage message = type.make();
    ServiceHeader header;
    const bool has_header = sample.json.contains("header");

    const auto read = has_header
                          ? read_service_cdr(cdr, Pieces(payload).all(), header, message.get())
                          : read_cdr(cdr, Pieces(payload).all(), message.get());
    ASSERT_TRUE(read) << read.error().text();
    const OwnedGenericMessage expected = type.make();
    test::set_message(type.members(), value_of(sample), expected.get());
    std::string where;
    EXPECT_TRUE(test::are_same(type.members(), message.get(), expected.get(), &where)) << where;
    if (has_header) {
      const auto& said = sample.json.at("header");
      EXPECT_EQ(test::hex_of(std::as_bytes(std::span(&header.client_id, 1))),
                said.at("client_id_hex").get<std::string>());
      EXPECT_EQ(header.sequence_number, said.at("sequence_number").get<std::int64_t>());
    }

    Bytes again(has_header ? service_cdr_bytes(cdr, message.get()) : cdr_bytes(cdr, message.get()));
    const auto written = has_header ? write_service_cdr(cdr, header, message.get(), again)
                                    : write_cdr(cdr, message.get(), again);
    ASSERT_TRUE(written) << written.error().text();
    EXPECT_EQ(*written, *read);
    // rmw_cyclonedds pads payloads with zeros to a multiple of 4.
    again.resize((again.size() + 3) / 4 * 4);
    EXPECT_EQ(test::hex_of(again), test::hex_of(payload));
  }
}

TEST_F(GoldenWire, TopicsAndTypesOfPacketsHaveRosNames) {
  for (const Sample& sample : test::samples_with("dds_topic")) {
    SCOPED_TRACE(sample.file);
    const std::string topic = sample.text("dds_topic");
    const auto ros = ros_topic_of(topic);
    EXPECT_EQ(ros.has_value(), topic != discovery_topic);
    if (ros) {
      EXPECT_EQ(dds_topic_of(*ros), topic);
    }
    const auto type = ros_type_of(sample.text("dds_type"));
    ASSERT_TRUE(type);
    EXPECT_EQ(dds_type_of(*type), sample.text("dds_type"));
  }
}

TEST_F(GoldenWire, TopicsAndTypesOfDiscoveryHaveRosNames) {
  int count = 0;
  for (const Sample& sample : test::samples_with("parameters")) {
    SCOPED_TRACE(sample.file);
    for (const auto& parameter : sample.json.at("parameters")) {
      const auto kind = parameter.at("name").get<std::string>();
      if (kind != "TOPIC_NAME" && kind != "TYPE_NAME") continue;
      // A CDR string: its length, its characters, a zero, padding.
      const Bytes value = test::bytes_of_hex(parameter.at("value_hex").get<std::string>());
      const std::string name = reinterpret_cast<const char*>(value.data()) + 4;
      if (name == discovery_topic) continue;
      ++count;
      if (kind == "TOPIC_NAME") {
        const auto ros = ros_topic_of(name);
        ASSERT_TRUE(ros) << name;
        EXPECT_EQ(dds_topic_of(*ros), name);
      } else {
        const auto ros = ros_type_of(name);
        ASSERT_TRUE(ros) << name;
        EXPECT_EQ(dds_type_of(*ros), name);
      }
    }
  }
  EXPECT_GT(count, 0);
}

}  // namespace
}  // namespace agnocast::bridge
