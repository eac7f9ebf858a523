// SPDX-License-Identifier: Apache-2.0
//
// Goal: a message is the same in C and in C++, whatever it holds, and a message of another process
// is followed only into its publisher's memory. Method: random messages with every kind of member
// go there and back, judged by the equality that rosidl generates for each layout; then words of a
// message in one block of memory are replaced by lies.

#include <ros2/rmw_agnocast_cpp/core/c_layout.hpp>
#include <tests/support/messages/everything_in_c.hpp>
#include <tests/support/messages/random_message.hpp>

#include <client/api/message_copy.hpp>

#include <rosidl_runtime_c/string_functions.h>

#include <gtest/gtest.h>

#include <cstddef>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

namespace agnocast::rmw {
namespace {

using agnocast_test_msgs::msg::Everything;
using agnocast_test_msgs::msg::Forest;
using test::InC;
using test::make_in_c;

template <class T>
const CMembers& c_members() {
  return *static_cast<const CMembers*>(InC<T>::handle()->data);
}
template <class T>
const MessageMembers& cpp_members() {
  return *static_cast<const MessageMembers*>(MessageTraits<T>::table());
}
template <class T>
const CLayout& layout() {
  static const CLayout made = CLayout::of(c_members<T>(), cpp_members<T>()).value();
  return made;
}
template <class T>
T random_message(std::uint64_t seed) {
  T message;
  test::RandomMessages(seed, {false, true}).fill(cpp_members<T>(), &message);
  return message;
}

template <class T>
void expect_there_and_back(std::uint64_t seed) {
  const T original = random_message<T>(seed);
  auto in_c = make_in_c<T>(), again = make_in_c<T>();
  ASSERT_TRUE(layout<T>().to_c(&original, in_c.get()));
  // Into one that holds something already.
  T back = random_message<T>(seed + 1);
  ASSERT_TRUE(layout<T>().to_cpp(in_c.get(), &back));
  EXPECT_EQ(back, original);
  ASSERT_TRUE(layout<T>().to_c(&back, again.get()));
  EXPECT_TRUE(InC<T>::are_equal(in_c.get(), again.get()));
  const T other = random_message<T>(seed + 1);
  ASSERT_TRUE(layout<T>().to_c(&other, again.get()));
  EXPECT_EQ(InC<T>::are_equal(in_c.get(), again.get()), other == original);
}

TEST(CLayout, MessagesAreTheSameThereAndBack) {
  for (std::uint64_t seed = 0; seed < 200; seed += 2) {
    SCOPED_TRACE(seed);
    expect_there_and_back<Everything>(seed);
    expect_there_and_back<Forest>(seed);
    if (testing::Test::HasFailure()) return;
  }
}

TEST(CLayout, MembersArriveWhereCReadsThem) {
  Everything original;
  original.text = "text";
  original.flags = {true, false, true};
  original.fixed_texts[2] = "third";
  original.numbers = {1.5, 2.5};
  original.wide = u"wide";
  original.inners.resize(2);
  original.inners[1].blob = {7, 8, 9};
  original.flats.resize(1);
  original.flats[0].y = 4.25;
  auto in_c = make_in_c<Everything>();
  ASSERT_TRUE(layout<Everything>().to_c(&original, in_c.get()));
  EXPECT_STREQ(in_c->text.data, "text");
  ASSERT_EQ(in_c->flags.size, 3u);
  EXPECT_FALSE(in_c->flags.data[1]);
  EXPECT_STREQ(in_c->fixed_texts[2].data, "third");
  ASSERT_EQ(in_c->numbers.size, 2u);
  EXPECT_EQ(in_c->numbers.data[1], 2.5);
  ASSERT_EQ(in_c->wide.size, 4u);
  EXPECT_EQ(in_c->wide.data[0], u'w');
  ASSERT_EQ(in_c->inners.size, 2u);
  ASSERT_EQ(in_c->inners.data[1].blob.size, 3u);
  EXPECT_EQ(in_c->inners.data[1].blob.data[2], 9);
  EXPECT_EQ(in_c->flats.data[0].y, 4.25);
}

TEST(CLayout, AMessageOfZerosIsEmpty) {
  const agnocast_test_msgs__msg__Everything zeros{};
  Everything target = random_message<Everything>(5);
  ASSERT_TRUE(layout<Everything>().to_cpp(&zeros, &target));
  EXPECT_EQ(target, Everything());
}

TEST(CLayout, RefusesWhatIsTooLongAndNamesIt) {
  auto in_c = make_in_c<Everything>();
  Everything target;
  const auto refusal = [&] {
    const Result<void> copied = layout<Everything>().to_cpp(in_c.get(), &target);
    return copied ? std::string() : text_of(copied.error());
  };
  ASSERT_TRUE(rosidl_runtime_c__String__assign(&in_c->bounded_text, std::string(41, 'x').c_str()));
  EXPECT_NE(refusal().find("bounded_text is longer"), std::string::npos) << refusal();
  ASSERT_TRUE(rosidl_runtime_c__String__assign(&in_c->bounded_text, "short"));
  ASSERT_TRUE(rosidl_runtime_c__String__Sequence__init(&in_c->texts_of_bounded, 2));
  ASSERT_TRUE(rosidl_runtime_c__String__assign(&in_c->texts_of_bounded.data[1],
                                               std::string(41, 'x').c_str()));
  EXPECT_NE(refusal().find("texts_of_bounded is longer"), std::string::npos) << refusal();
}

TEST(CLayout, RefusesTablesOfDifferentTypes) {
  EXPECT_FALSE(CLayout::of(c_members<Forest>(), cpp_members<Everything>()));
  // One member differs.
  CMembers other = c_members<Everything>();
  std::vector<rosidl_typesupport_introspection_c__MessageMember> members(
      other.members_, other.members_ + other.member_count_);
  other.members_ = members.data();
  ASSERT_TRUE(CLayout::of(other, cpp_members<Everything>()));
  const auto refuses = [&](std::size_t member, auto change) {
    const auto before = members[member];
    change(members[member]);
    const auto made = CLayout::of(other, cpp_members<Everything>());
    members[member] = before;
    return !made && text_of(made.error()).find(before.name_) != std::string::npos;
  };
  EXPECT_TRUE(refuses(3, [](auto& member) { member.type_id_ = 200; }));
  EXPECT_TRUE(refuses(1, [](auto& member) { ++member.array_size_; }));
  EXPECT_TRUE(refuses(1, [](auto& member) { member.is_upper_bound_ = false; }));
  EXPECT_TRUE(refuses(4, [](auto& member) { ++member.string_upper_bound_; }));
}

/// A message in one block of memory, as publishers without the heap hook make it.
class Block {
 public:
  explicit Block(const Everything& message) {
    const MessageType type = message_type_of<Everything>().value();
    const detail::MessageCopy copy(type, &message);
    words_.resize(copy.block_bytes() / sizeof(std::uint64_t) + 2);
    EXPECT_TRUE(copy.write(words_.data()));
    bytes_ = copy.block_bytes();
  }
  WindowSet window() const {
    WindowSet set;
    const auto begin = reinterpret_cast<std::uintptr_t>(words_.data());
    EXPECT_TRUE(set.add(begin, begin + bytes_));
    return set;
  }
  const void* message() const { return words_.data(); }
  std::vector<std::uint64_t>& words() { return words_; }

 private:
  // The words of an std::uint64_t vector are aligned like those of operator new.
  std::vector<std::uint64_t> words_;
  std::size_t bytes_ = 0;
};

TEST(CLayout, AMessageOfAnotherProcessArrives) {
  const Everything original = random_message<Everything>(11);
  const Block block(original);
  auto in_c = make_in_c<Everything>(), expected = make_in_c<Everything>();
  const WindowSet window = block.window();
  ASSERT_TRUE(layout<Everything>().to_c(block.message(), in_c.get(), &window));
  ASSERT_TRUE(layout<Everything>().to_c(&original, expected.get()));
  EXPECT_TRUE(InC<Everything>::are_equal(in_c.get(), expected.get()));
}

// Each word of the message object in turn says something else. AddressSanitizer, where it runs,
// judges what is read.
TEST(CLayout, NoLieLeadsOutOfThePublishersMemory) {
  const Everything original = random_message<Everything>(12);
  Block block(original);
  const WindowSet window = block.window();
  auto in_c = make_in_c<Everything>();
  int refused = 0;
  for (std::size_t i = 0; i < sizeof(Everything) / sizeof(std::uint64_t); ++i) {
    const std::uint64_t truth = block.words()[i];
    for (const std::uint64_t lie :
         {std::uint64_t{0}, std::uint64_t{1}, ~std::uint64_t{0}, std::uint64_t{1} << 40, truth + 8,
          truth - 8, truth + (std::uint64_t{1} << 32),
          reinterpret_cast<std::uint64_t>(block.message())}) {
      block.words()[i] = lie;
      const Result<void> copied = layout<Everything>().to_c(block.message(), in_c.get(), &window);
      if (!copied) {
        EXPECT_EQ(copied.error().code, Errc::protocol_violation);
        ++refused;
      }
    }
    block.words()[i] = truth;
  }
  EXPECT_GT(refused, 100);
  ASSERT_TRUE(layout<Everything>().to_c(block.message(), in_c.get(), &window));
}

TEST(CLayout, ATextOfNothingAtNoAddressIsEmpty) {
  Block block{Everything()};
  const WindowSet window = block.window();
  auto in_c = make_in_c<Everything>();
  const auto set = [&](std::size_t offset, std::uint64_t word) {
    std::memcpy(reinterpret_cast<std::byte*>(block.words().data()) + offset, &word, sizeof word);
  };
  for (const std::size_t member : {offsetof(Everything, text), offsetof(Everything, wide)}) {
    set(member, 0);
    set(member + sizeof(std::uint64_t), 0);
  }
  ASSERT_TRUE(layout<Everything>().to_c(block.message(), in_c.get(), &window));
  EXPECT_STREQ(in_c->text.data, "");
  EXPECT_EQ(in_c->wide.size, 0u);
}

TEST(CLayout, BoolsOfAnotherProcessAreZeroOrOne) {
  Everything original;
  std::memset(original.fixed_flags.data(), 0x55, original.fixed_flags.size());
  auto in_c = make_in_c<Everything>();
  ASSERT_TRUE(layout<Everything>().to_c(&original, in_c.get()));
  for (const bool& flag : in_c->fixed_flags) {
    unsigned char byte = 0;
    std::memcpy(&byte, &flag, 1);
    EXPECT_EQ(byte, 1);
  }
}

}  // namespace
}  // namespace agnocast::rmw
