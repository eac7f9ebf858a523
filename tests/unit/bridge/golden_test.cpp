// SPDX-License-Identifier: Apache-2.0
//
// Goal: bridge/cdr writes the bytes of ROS 2 and reads them back to the same message, in both byte
// orders and cut into any pieces. Method: samples of values with their bytes, with tables made
// from their own schema, and with the library of their package where one is built; messages are
// compared member by member. encode.py makes the big-endian bytes.

#include <bridge/cdr/cdr.hpp>
#include <bridge/dds/names.hpp>
#include <tests/support/messages/random_message.hpp>
#include <tests/support/processes/shell.hpp>
#include <tests/unit/bridge/golden_sample.hpp>
#include <tests/unit/bridge/pieces.hpp>

#include <gtest/gtest.h>

#if __has_include(<every_message_name.hpp>)
#include <every_message_name.hpp>
#endif

#include <algorithm>
#include <functional>
#include <map>
#include <sstream>

namespace agnocast::bridge {
namespace {

using test::Bytes;
using test::Pieces;
using test::Sample;

bool has_library(const std::string& type) {
#if __has_include(<every_message_name.hpp>)
  return std::find(std::begin(test::every_message_name), std::end(test::every_message_name),
                   type) != std::end(test::every_message_name);
#else
  (void)type;
  return false;
#endif
}

/// Runs `check` on each sample with each remote publisher of its type's table.
void for_every_sample(const std::function<void(const Sample&, const IntrospectedType&)>& check) {
  const std::vector<Sample> samples = test::samples_with("cdr_hex");
  ASSERT_FALSE(samples.empty());
  for (const Sample& sample : samples) {
    const std::string type = sample.text("ros_type");
    {
      SCOPED_TRACE(sample.file + " by its schema");
      check(sample, IntrospectedType(test::members_of_schema(sample.schema(), type)));
    }
    if (!has_library(type)) continue;
    SCOPED_TRACE(sample.file + " by its library");
    check(sample, find_message_type(type));
  }
}

OwnedGenericMessage message_of(const Sample& sample, const IntrospectedType& type) {
  OwnedGenericMessage message = type.make();
  test::set_message(type.members(), sample.json.at("value"), message.get());
  return message;
}

CdrType compiled(const IntrospectedType& type) { return CdrType::of(type.members()).value(); }

void expect_read(const IntrospectedType& type, const CdrType& cdr, const Pieces& pieces,
                 std::size_t length, const OwnedGenericMessage& expected,
                 OwnedGenericMessage message) {
  const auto read = read_cdr(cdr, pieces.all(), message.get());
  ASSERT_TRUE(read) << read.error().text();
  EXPECT_EQ(*read, length);
  std::string where;
  EXPECT_TRUE(test::are_same(type.members(), message.get(), expected.get(), &where)) << where;
}

TEST(GoldenCdr, EveryMessageIsWrittenByteForByte) {
  for_every_sample([](const Sample& sample, const IntrospectedType& type) {
    const OwnedGenericMessage message = message_of(sample, type);
    const CdrType cdr = compiled(type);
    const std::size_t length = cdr_bytes(cdr, message.get());
    EXPECT_EQ(length, sample.json.at("length").get<std::size_t>());
    // The old contents of the memory reveal bytes that are not written.
    Bytes memory(length, std::byte{0xa5});
    const auto written = write_cdr(cdr, message.get(), memory);
    ASSERT_TRUE(written) << written.error().text();
    EXPECT_EQ(*written, length);
    EXPECT_EQ(test::hex_of(memory), sample.text("cdr_hex"));
  });
}

TEST(GoldenCdr, NoMessageIsWrittenIntoABufferShorterThanItself) {
  for_every_sample([](const Sample& sample, const IntrospectedType& type) {
    const OwnedGenericMessage message = message_of(sample, type);
    const CdrType cdr = compiled(type);
    const std::size_t length = cdr_bytes(cdr, message.get());
    for (std::size_t room = 0; room < length; ++room) {
      Bytes memory(length, std::byte{0xa5});
      const auto written = write_cdr(cdr, message.get(), std::span(memory).first(room));
      ASSERT_FALSE(written);
      EXPECT_EQ(written.error().reason, CdrReason::no_room);
      EXPECT_TRUE(std::all_of(memory.begin() + static_cast<std::ptrdiff_t>(room), memory.end(),
                              [](std::byte byte) { return byte == std::byte{0xa5}; }));
    }
  });
}

TEST(GoldenCdr, EveryMessageIsReadFromAnyTwoPiecesAndFromSingleBytes) {
  for_every_sample([](const Sample& sample, const IntrospectedType& type) {
    const OwnedGenericMessage expected = message_of(sample, type);
    const CdrType cdr = compiled(type);
    const Bytes bytes = test::bytes_of_hex(sample.text("cdr_hex"));
    for (std::size_t first = 0; first <= bytes.size(); ++first)
      expect_read(type, cdr, Pieces(bytes, {first}), bytes.size(), expected, type.make());
    expect_read(type, cdr, Pieces::of_single_bytes(bytes), bytes.size(), expected, type.make());
  });
}

TEST(GoldenCdr, ReadingReplacesTheOldContentOfAMessage) {
  test::RandomMessages random(5, {});
  for_every_sample([&](const Sample& sample, const IntrospectedType& type) {
    OwnedGenericMessage message = type.make();
    random.fill(type.members(), message.get());
    const Bytes bytes = test::bytes_of_hex(sample.text("cdr_hex"));
    expect_read(type, compiled(type), Pieces(bytes), bytes.size(), message_of(sample, type),
                std::move(message));
  });
}

TEST(GoldenCdr, BytesBehindTheMessageAreIgnored) {
  for_every_sample([](const Sample& sample, const IntrospectedType& type) {
    const Bytes bytes = test::bytes_of_hex(sample.text("cdr_hex"));
    for (std::size_t more = 1; more <= 8; ++more) {
      Bytes longer = bytes;
      longer.resize(bytes.size() + more, std::byte{0xff});
      expect_read(type, compiled(type), Pieces(longer), bytes.size(), message_of(sample, type),
                  type.make());
    }
  });
}

TEST(GoldenCdr, NoPrefixOfAMessageIsAcceptedAsAMessage) {
  for_every_sample([](const Sample& sample, const IntrospectedType& type) {
    const CdrType cdr = compiled(type);
    const Bytes bytes = test::bytes_of_hex(sample.text("cdr_hex"));
    const OwnedGenericMessage message = type.make();
    for (std::size_t length = 0; length < bytes.size(); ++length) {
      const auto read = read_cdr(cdr, Pieces(std::span(bytes).first(length)).all(), message.get());
      ASSERT_FALSE(read) << length;
      EXPECT_TRUE(read.error().reason == CdrReason::truncated ||
                  read.error().reason == CdrReason::overlong)
          << read.error().text();
      EXPECT_LE(read.error().byte, length);
      EXPECT_EQ(read.error().member.empty(), length < 4) << read.error().text();
    }
  });
}

/// Returns the bytes by the name of the sample.
std::map<std::string, Bytes> big_endian_bytes() {
  std::string command =
      "'" AGNOCAST_PYTHON "' '" + (test::own_samples() / "encode.py").string() + "' --big-endian";
  for (const auto& folder : {test::own_samples(), test::recorded_samples()}) {
    if (!folder.empty()) command += " '" + folder.string() + "'";
  }
  const auto encoded = test::run_in_shell(command);
  EXPECT_EQ(encoded.status, 0) << command;
  std::map<std::string, Bytes> all;
  std::istringstream words(encoded.text);
  for (std::string name, hex; words >> name >> hex;) all[name] = test::bytes_of_hex(hex);
  return all;
}

TEST(GoldenCdr, EveryMessageIsAlsoReadFromBigEndianBytes) {
  const auto big_endian = big_endian_bytes();
  for_every_sample([&](const Sample& sample, const IntrospectedType& type) {
    const auto bytes = big_endian.find(sample.text("name"));
    ASSERT_NE(bytes, big_endian.end());
    const CdrType cdr = compiled(type);
    const OwnedGenericMessage expected = message_of(sample, type);
    const std::size_t length = bytes->second.size();
    expect_read(type, cdr, Pieces(bytes->second), length, expected, type.make());
    expect_read(type, cdr, Pieces::of_single_bytes(bytes->second), length, expected, type.make());
  });
}

TEST(GoldenCdr, TypesHaveTheNamesThatRosUses) {
  for (const Sample& sample : test::samples_with("cdr_hex")) {
    SCOPED_TRACE(sample.file);
    EXPECT_EQ(dds_type_of(sample.text("ros_type")), sample.text("dds_type"));
    EXPECT_EQ(ros_type_of(sample.text("dds_type")), sample.text("ros_type"));
  }
}

TEST(GoldenCdr, RecordedSamplesExist) {
  if (test::recorded_samples().empty())
    GTEST_SKIP() << "AGNOCAST_GOLDEN_CDR_DIR names no folder: only the samples of tests/golden "
                    "were compared";
  EXPECT_TRUE(std::any_of(std::filesystem::directory_iterator(test::recorded_samples()), {},
                          [](const auto& entry) { return entry.path().extension() == ".json"; }));
}

}  // namespace
}  // namespace agnocast::bridge
