// SPDX-License-Identifier: Apache-2.0
//
// Goal: reading returns what was written, for every type of interfaces/; other bytes are refused
// with their position; nothing invalid gets into memory. Method: random messages made from the
// type's table; bytes written by hand. golden_test.cpp compares the bytes themselves.

#include <bridge/cdr/cdr.hpp>
#include <tests/support/messages/random_message.hpp>
#include <tests/support/schema_tables.hpp>
#include <tests/unit/bridge/golden_sample.hpp>
#include <tests/unit/bridge/pieces.hpp>

#include <gtest/gtest.h>

#if __has_include(<every_message_name.hpp>)
#include <every_message_name.hpp>
#endif

#include <random>
#include <utility>

namespace agnocast::bridge {
namespace {

using test::Bytes;
using test::Pieces;
using test::Schema;

/// A type with one message, for bytes that are written by hand.
struct Probe {
  explicit Probe(const Schema& schema, const std::string& root = "p/msg/Root")
      : type(test::members_of_schema(schema, root)),
        cdr(CdrType::of(type.members()).value()),
        message(type.make()) {}
  explicit Probe(const std::string& field) : Probe({{"p/msg/Root", {{"value", field}}}}) {}

  /// Returns "" if the bytes can be read, else the reason.
  std::string read(const std::string& hex) {
    const auto read = read_cdr(cdr, Pieces(test::bytes_of_hex(hex)).all(), message.get());
    return read ? "" : read.error().text();
  }
  std::string written() const {
    Bytes bytes(cdr_bytes(cdr, message.get()));
    const auto written = write_cdr(cdr, message.get(), bytes);
    return written ? test::hex_of(bytes) : written.error().text();
  }
  template <class T>
  T& value() const {
    return *reinterpret_cast<T*>(message.get());
  }

  IntrospectedType type;
  CdrType cdr;
  OwnedGenericMessage message;
};

void expect_round_trip(const IntrospectedType& type, const CdrType& cdr, const void* message,
                       std::mt19937& random) {
  Bytes bytes(cdr_bytes(cdr, message));
  const auto written = write_cdr(cdr, message, bytes);
  ASSERT_TRUE(written) << written.error().text();
  ASSERT_EQ(*written, bytes.size());
  std::vector<std::size_t> lengths;
  for (int i = 0; i < 5; ++i) lengths.push_back(random() % (bytes.size() + 1));
  const OwnedGenericMessage read = type.make();
  const auto took = read_cdr(cdr, Pieces(bytes, lengths).all(), read.get());
  ASSERT_TRUE(took) << took.error().text();
  EXPECT_EQ(*took, bytes.size());
  std::string where;
  EXPECT_TRUE(test::are_same(type.members(), read.get(), message, &where)) << where;
  Bytes again(bytes.size());
  ASSERT_TRUE(write_cdr(cdr, read.get(), again));
  EXPECT_EQ(test::hex_of(again), test::hex_of(bytes));
}

#if __has_include(<every_message_name.hpp>)
TEST(Cdr, RandomMessagesOfEveryTypeAreReadAsTheyWereWritten) {
  test::RandomMessages messages(17, {});
  std::mt19937 random(18);
  for (const char* const name : test::every_message_name) {
    SCOPED_TRACE(name);
    const IntrospectedType type = find_message_type(name);
    const auto cdr = CdrType::of(type.members());
    ASSERT_TRUE(cdr) << text_of(cdr.error());
    for (int round = 0; round < 25 && !HasFailure(); ++round) {
      const OwnedGenericMessage message = type.make();
      messages.fill(type.members(), message.get());
      expect_round_trip(type, *cdr, message.get(), random);
    }
  }
}
#endif

TEST(Cdr, RandomMessagesOfEverySampleAreReadAsTheyWereWritten) {
  test::RandomMessages messages(19, {});
  std::mt19937 random(20);
  for (const test::Sample& sample : test::samples_with("schema")) {
    SCOPED_TRACE(sample.file);
    const IntrospectedType type(test::members_of_schema(sample.schema(), sample.text("ros_type")));
    const CdrType cdr = CdrType::of(type.members()).value();
    for (int round = 0; round < 8 && !HasFailure(); ++round) {
      const OwnedGenericMessage message = type.make();
      messages.fill(type.members(), message.get());
      expect_round_trip(type, cdr, message.get(), random);
    }
  }
}

TEST(Cdr, EachTruncationNamesTheMemberThatItCuts) {
  Probe probe({{"p/msg/Root",
                {{"stamp", "p/msg/Time"},
                 {"fields", "p/msg/Field[]"},
                 {"points", "p/msg/Point[]"},
                 {"grid", "uint16[3]"},
                 {"flags", "bool[]"},
                 {"wide", "wstring"}}},
               {"p/msg/Time", {{"sec", "int32"}, {"nanosec", "uint32"}}},
               {"p/msg/Field", {{"name", "string"}, {"offset", "uint16"}}},
               {"p/msg/Point", {{"x", "float32"}, {"y", "float32"}}}});
  const std::string hex =
      "00010000"
      "01000000"      // 4 stamp.sec
      "02000000"      // 8 stamp.nanosec
      "02000000"      // 12 fields
      "02000000"      // 16 fields[0].name
      "6100"          // 20
      "0300"          // 22 fields[0].offset
      "01000000"      // 24 fields[1].name
      "0000"          // 28 and padding
      "0400"          // 30 fields[1].offset
      "01000000"      // 32 points
      "0000803f"      // 36 points[0].x
      "00000040"      // 40 points[0].y
      "010002000300"  // 44 grid
      "0000"          // 50 padding
      "02000000"      // 52 flags
      "0100"          // 56
      "0000"          // 58 padding
      "01000000"      // 60 wide
      "61000000";     // 64
  ASSERT_EQ(probe.read(hex), "");
  const auto cut = [&](std::size_t length) { return probe.read(hex.substr(0, 2 * length)); };
  EXPECT_EQ(cut(0), "truncated at byte 0");
  EXPECT_EQ(cut(3), "truncated at byte 3");
  const std::pair<std::size_t, const char*> names[] = {
      {4, "stamp.sec"}, {7, "stamp.sec"}, {8, "stamp.nanosec"}, {11, "stamp.nanosec"},
      {12, "fields"},   {15, "fields"},   {32, "points"},       {35, "points"},
      {44, "grid[0]"},  {45, "grid[0]"},  {46, "grid[1]"},      {49, "grid[2]"},
      {50, "flags"},    {55, "flags"},    {58, "wide"},         {63, "wide"},
  };
  for (const auto& [length, member] : names) {
    EXPECT_EQ(cut(length),
              "truncated at byte " + std::to_string(length) + " in " + std::string(member));
  }
  // A count that the rest cannot hold is refused at its position, before its elements.
  const auto overlong = [](int byte, const char* member) {
    return "a count that the rest of the input cannot hold at byte " + std::to_string(byte) +
           " in " + member;
  };
  EXPECT_EQ(cut(16), overlong(12, "fields"));
  EXPECT_EQ(cut(21), overlong(12, "fields"));
  EXPECT_EQ(cut(27), overlong(12, "fields"));
  EXPECT_EQ(cut(28), overlong(24, "fields[1].name"));
  EXPECT_EQ(cut(29), "truncated at byte 29 in fields[1].offset");
  EXPECT_EQ(cut(31), "truncated at byte 31 in fields[1].offset");
  EXPECT_EQ(cut(36), overlong(32, "points"));
  EXPECT_EQ(cut(43), overlong(32, "points"));
  EXPECT_EQ(cut(57), overlong(52, "flags"));
  EXPECT_EQ(cut(64), overlong(60, "wide"));
  EXPECT_EQ(cut(67), overlong(60, "wide"));
}

TEST(Cdr, ElementsPushedOutByPaddingAreNamedWithTheirIndex) {
  Probe probe({{"p/msg/Root", {{"list", "p/msg/Pair[]"}}},
               {"p/msg/Pair", {{"a", "float64"}, {"b", "float64"}}}});
  // Two elements of 16 bytes at offset 8, not 4, of the body: room for one and a half.
  EXPECT_EQ(probe.read("0001000002000000" + std::string(2 * 32, '0')),
            "truncated at byte 40 in list[1].b");
  EXPECT_EQ(probe.read("0001000002000000" + std::string(2 * 36, '0')), "");
}

TEST(Cdr, PaddingMayHoldAnything) {
  Probe probe(
      {{"p/msg/Root", {{"a", "uint8"}, {"b", "float64"}, {"c", "uint8"}, {"d", "uint32"}}}});
  EXPECT_EQ(probe.read("0001000001"
                       "deadbeefdeadbe"
                       "000000000000f03f"
                       "02"
                       "ffffff"
                       "03000000"),
            "");
  EXPECT_EQ(probe.written(),
            "0001000001"
            "00000000000000"
            "000000000000f03f"
            "02"
            "000000"
            "03000000");
}

TEST(Cdr, EncapsulationDecidesTheByteOrderByItsSecondByte) {
  Probe probe("uint32");
  EXPECT_EQ(probe.read("0001000001000000"), "");
  EXPECT_EQ(probe.value<std::uint32_t>(), 1U);
  EXPECT_EQ(probe.read("ff01abcd01000000"), "");
  EXPECT_EQ(probe.value<std::uint32_t>(), 1U);
  EXPECT_EQ(probe.read("0000000000000001"), "");
  EXPECT_EQ(probe.value<std::uint32_t>(), 1U);
}

TEST(Cdr, OtherEncapsulationsAreRefusedByTheirNames) {
  Probe probe("uint32");
  for (const char* const kind : {"02", "03"})
    EXPECT_EQ(probe.read("00" + std::string(kind) + "000001000000"),
              "a parameter list instead of plain CDR at byte 1");
  for (const char* const kind : {"06", "07", "08", "09", "0a", "0b"})
    EXPECT_EQ(probe.read("00" + std::string(kind) + "000001000000"),
              "XCDR2 instead of XCDR1 at byte 1");
}

TEST(Cdr, StringsEndWithAZero) {
  Probe probe("string");
  EXPECT_EQ(probe.read("00010000"
                       "03000000"
                       "616200"),
            "");
  EXPECT_EQ(probe.value<std::string>(), "ab");
  EXPECT_EQ(probe.read("00010000"
                       "03000000"
                       "616263"),
            "a string without a zero at its end at byte 10 in value");
}

TEST(Cdr, AStringOfLengthZeroIsEmpty) {
  Probe probe("string");
  probe.value<std::string>() = "before";
  EXPECT_EQ(probe.read("00010000"
                       "00000000"),
            "");
  EXPECT_EQ(probe.value<std::string>(), "");
  // It is written as rclcpp writes it.
  EXPECT_EQ(probe.written(),
            "0001000001000000"
            "00");
}

TEST(Cdr, BoolsAreZeroOrOneInMemory) {
  const auto byte_of = [](const void* at) { return *static_cast<const unsigned char*>(at); };
  Probe one("bool");
  EXPECT_EQ(one.read("0001000002"), "");
  EXPECT_EQ(byte_of(one.message.get()), 1);
  EXPECT_EQ(one.read("0001000000"), "");
  EXPECT_EQ(byte_of(one.message.get()), 0);
  Probe array("bool[3]");
  EXPECT_EQ(array.read("00010000ff0080"), "");
  EXPECT_EQ(array.written(), "00010000010001");
  Probe sequence("bool[]");
  EXPECT_EQ(sequence.read("0001000003000000ff0080"), "");
  EXPECT_EQ(sequence.value<std::vector<bool>>(), std::vector<bool>({true, false, true}));
  Probe elements({{"p/msg/Root", {{"list", "p/msg/Flags[]"}}},
                  {"p/msg/Flags", {{"a", "bool"}, {"n", "uint8"}}}});
  EXPECT_EQ(elements.read("000100000200000002020303"), "");
  EXPECT_EQ(elements.written(), "000100000200000001020103");
}

TEST(Cdr, BoolsOfAPublisherAreWrittenAsZeroOrOne) {
  Probe probe("bool[2]");
  std::memset(probe.message.get(), 0x40, 2);
  EXPECT_EQ(probe.written(), "000100000101");
}

TEST(Cdr, BoundsAreKeptWhenReading) {
  const std::string why = "more than the type allows at byte 4 in value";
  Probe numbers("uint8[<=2]");
  EXPECT_EQ(numbers.read("00010000020000000102"), "");
  EXPECT_EQ(numbers.read("0001000003000000010203"), why);
  Probe bits("bool[<=2]");
  EXPECT_EQ(bits.read("0001000003000000010101"), why);
  Probe text("string<=2");
  EXPECT_EQ(text.read("0001000003000000616200"), "");
  EXPECT_EQ(text.read("000100000400000061626300"), why);
  Probe wide("wstring<=1");
  EXPECT_EQ(wide.read("000100000100000061000000"), "");
  EXPECT_EQ(wide.read("00010000020000006100000062000000"), why);
}

TEST(Cdr, BoundsAreKeptWhenWriting) {
  Probe text("string<=2");
  text.value<std::string>() = "abc";
  EXPECT_EQ(text.written(), "more than the type allows at byte 4 in value");
  Probe texts("string<=2[]");
  texts.value<std::vector<std::string>>() = {"", "abc"};
  EXPECT_EQ(texts.written(), "more than the type allows at byte 13 in value[1]");
  Probe numbers("uint8[<=2]");
  numbers.value<std::vector<std::uint8_t>>() = {1, 2, 3};
  EXPECT_EQ(numbers.written(), "more than the type allows at byte 4 in value");
}

TEST(Cdr, WideCharactersHaveSixteenBits) {
  Probe probe("wstring");
  EXPECT_EQ(probe.read("00010000"
                       "02000000"
                       "ffff0000"
                       "00d80000"),
            "");
  EXPECT_EQ(probe.value<std::u16string>(), std::u16string({0xffff, 0xd800}));
  EXPECT_EQ(probe.read("00010000"
                       "02000000"
                       "61000000"
                       "00000100"),
            "a wide character of more than 16 bits at byte 12 in value");
}

TEST(Cdr, AServiceHeaderStandsBeforeTheBody) {
  Probe probe({{"p/msg/Root", {{"a", "uint8"}, {"b", "int64"}}}});
  ASSERT_EQ(probe.read("00010000"
                       "0500000000000000"
                       "feffffffffffffff"),
            "");
  const ServiceHeader header{0x0123456789abcdef, -2};
  Bytes bytes(service_cdr_bytes(probe.cdr, probe.message.get()));
  ASSERT_TRUE(write_service_cdr(probe.cdr, header, probe.message.get(), bytes));
  EXPECT_EQ(test::hex_of(bytes),
            "00010000"
            "efcdab8967452301"
            "feffffffffffffff"
            "0500000000000000"
            "feffffffffffffff");
  for (std::size_t room = 0; room < bytes.size(); ++room) {
    const auto none =
        write_service_cdr(probe.cdr, header, probe.message.get(), std::span(bytes).first(room));
    ASSERT_FALSE(none);
    EXPECT_EQ(none.error().reason, CdrReason::no_room);
  }
  const auto read = [&](const Pieces& pieces) {
    ServiceHeader got;
    const OwnedGenericMessage message = probe.type.make();
    const auto took = read_service_cdr(probe.cdr, pieces.all(), got, message.get());
    EXPECT_TRUE(took && *took == bytes.size());
    EXPECT_EQ(got, header);
    EXPECT_TRUE(test::are_same(probe.type.members(), message.get(), probe.message.get()));
  };
  read(Pieces(bytes));
  read(Pieces::of_single_bytes(bytes));
  read(
      Pieces(test::bytes_of_hex("00000000"
                                "0123456789abcdef"
                                "fffffffffffffffe"
                                "0500000000000000"
                                "fffffffffffffffe")));
  for (std::size_t length = 0; length < 20; ++length) {
    ServiceHeader got;
    const auto none = read_service_cdr(probe.cdr, Pieces(std::span(bytes).first(length)).all(), got,
                                       probe.message.get());
    ASSERT_FALSE(none);
    EXPECT_EQ(none.error().text(), "truncated at byte " + std::to_string(length));
  }
}

TEST(Cdr, AMessageThatGrowsBeforeTheWriteDoesNotOverflowTheBuffer) {
  Probe probe("uint8[]");
  auto& value = probe.value<std::vector<std::uint8_t>>();
  Bytes memory(32, std::byte{0xa5});
  const auto write_after_change = [&](std::size_t count) {
    value.assign(4, 0x11);
    const std::size_t measured = cdr_bytes(probe.cdr, probe.message.get());
    value.resize(count);
    return write_cdr(probe.cdr, probe.message.get(), std::span(memory).first(measured));
  };
  const auto grown = write_after_change(5);
  ASSERT_FALSE(grown);
  EXPECT_EQ(grown.error().text(), "no room, or the message changed at byte 8 in value");
  EXPECT_EQ(memory[12], std::byte{0xa5});
  const auto shrunk = write_after_change(3);
  ASSERT_TRUE(shrunk);
  EXPECT_EQ(*shrunk, 11U);
}

TEST(Cdr, TypesWithoutBytesInCdrAreRefusedByMember) {
  // As rosidl would describe such types.
  MessageMember member{};
  member.name_ = "value";
  MessageMembers members{};
  members.message_name_ = "Odd";
  members.members_ = &member;
  members.member_count_ = 1;
  const rosidl_message_type_support_t own{nullptr, &members, nullptr};
  const auto why = [&] {
    const auto type = CdrType::of(members);
    return type ? std::string() : text_of(type.error());
  };
  for (const auto type_id :
       {rosidl_typesupport_introspection_cpp::ROS_TYPE_WCHAR,
        rosidl_typesupport_introspection_cpp::ROS_TYPE_LONG_DOUBLE, std::uint8_t{200}}) {
    member.type_id_ = type_id;
    EXPECT_NE(why().find("CDR of Odd: value: wchar, long double or an unknown type"),
              std::string::npos)
        << why();
  }
  // A table that contains itself, which is possible only through a sequence.
  member.type_id_ = rosidl_typesupport_introspection_cpp::ROS_TYPE_MESSAGE;
  member.is_array_ = true;
  member.members_ = &own;
  EXPECT_NE(why().find("nested too deep"), std::string::npos) << why();
  members.member_count_ = 0;
  EXPECT_NE(why().find("CDR of Odd: a message without members"), std::string::npos) << why();
}

}  // namespace
}  // namespace agnocast::bridge
