// SPDX-License-Identifier: Apache-2.0
//
// Goal: the copy of a message in one block is equal to the message, refers to nothing outside the
// block, and stays so when the original is gone. Method: messages with every kind of member, and
// random ones; the generated operator== and the residency check judge the copy, and a second
// message, made from the same seed, is what it has to be equal to.

#include <client/api/message_copy.hpp>
#include <tests/unit/client/api/random_filler.hpp>
#include <tests/unit/client/api/residency_messages.hpp>

#include <cstring>
#include <new>

namespace agnocast {
namespace test {
namespace {

/// A block with guard bytes behind it.
class Block {
 public:
  static constexpr std::size_t guard_bytes = 64;
  explicit Block(const detail::MessageCopy& copy)
      : bytes_(copy.block_bytes()),
        alignment_(copy.alignment()),
        start_(static_cast<std::byte*>(
            ::operator new(bytes_ + guard_bytes, std::align_val_t(alignment_)))) {
    std::memset(start_, 0xA5, bytes_ + guard_bytes);
  }
  ~Block() { ::operator delete(start_, std::align_val_t(alignment_)); }
  Block(const Block&) = delete;
  Block& operator=(const Block&) = delete;

  std::byte* start() const { return start_; }
  bool has_guard() const {
    for (std::size_t i = 0; i < guard_bytes; ++i) {
      if (start_[bytes_ + i] != std::byte{0xA5}) return false;
    }
    return true;
  }
  WindowSet window() const {
    WindowSet set;
    const auto begin = reinterpret_cast<std::uintptr_t>(start_);
    EXPECT_TRUE(set.add(begin, begin + bytes_));
    return set;
  }

 private:
  std::size_t bytes_, alignment_;
  std::byte* start_;
};

/// Copies `original`, which this destroys before the copy is compared with `twin`.
template <class T>
void expect_copy(std::unique_ptr<T> original, const T& twin) {
  const MessageType& type = type_of<T>();
  ASSERT_TRUE(detail::is_copied_into_block(type));
  const HeapCounters before = heap_counters();
  const detail::MessageCopy copy(type, original.get());
  const std::uint64_t measured = heap_counters().allocations;
  EXPECT_EQ(measured, before.allocations) << "measuring allocated memory";
  const Block block(copy);
  const HeapCounters made = heap_counters();
  ASSERT_TRUE(copy.write(block.start()));
  EXPECT_EQ(heap_counters().allocations, made.allocations) << "copying allocated memory";
  original.reset();
  EXPECT_TRUE(block.has_guard());
  const auto& message = *std::launder(reinterpret_cast<const T*>(block.start()));
  EXPECT_EQ(message, twin);
  const Residency found = check_residency(type, &message, block.window());
  EXPECT_TRUE(found.is_resident()) << path_of(found);
  EXPECT_LE(found.message_bytes, copy.block_bytes());
  // What a subscription does with it.
  EXPECT_EQ(T(message), twin);
}

template <class Make>
void expect_copy_of(Make&& make) {
  auto original = std::unique_ptr<std::remove_pointer_t<decltype(make())>>(make());
  const auto twin = *original;
  expect_copy(std::move(original), twin);
}

TEST(MessageCopy, HasEveryKindOfMember) {
  expect_copy_of(make_cloud);
  expect_copy_of(make_everything);
  expect_copy_of(make_forest);
}

TEST(MessageCopy, OfAnEmptyMessageRefersToNothing) {
  expect_copy_of([] { return new PointCloud2; });
  expect_copy_of([] { return new Everything; });
  expect_copy_of([] { return new agnocast_test_msgs::msg::Empty; });
  expect_copy_of([] { return new geometry_msgs::msg::Point; });
}

TEST(MessageCopy, HasTextsOfEachLengthAroundWhatAStringHolds) {
  for (std::size_t size = 0; size < 40; ++size) {
    SCOPED_TRACE(size);
    expect_copy_of([&] {
      auto message = std::make_unique<Everything>();
      message->text.assign(size, 'x');
      message->wide.assign(size, u'x');
      message->texts = {std::string(size, 'a'), std::string(size + 1, 'b')};
      message->texts[0].reserve(100);
      message->flags.resize(size * 3);
      for (std::size_t i = 0; i < message->flags.size(); ++i) message->flags[i] = i % 3 == 0;
      return message.release();
    });
  }
}

TEST(MessageCopy, AlignsEachPiece) {
  for (std::size_t size = 0; size < 8; ++size) {
    Everything message;
    message.text.assign(17 + size, 'x');
    message.numbers = {1.5, 2.5};
    message.inners.resize(2);
    for (auto& inner : message.inners) inner.blob.assign(1 + size, 1);
    const detail::MessageCopy copy(type_of<Everything>(), &message);
    const Block block(copy);
    ASSERT_TRUE(copy.write(block.start()));
    const auto& made = *std::launder(reinterpret_cast<const Everything*>(block.start()));
    EXPECT_EQ(made, message);
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(made.numbers.data()) % 16, 0U);
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(made.inners.data()) % 16, 0U);
  }
}

TEST(MessageCopy, IsRefusedIfTheMessageGrewMeanwhile) {
  auto message = std::make_unique<PointCloud2>();
  message->data.assign(100, 1);
  const detail::MessageCopy copy(type_of<PointCloud2>(), message.get());
  const Block block(copy);
  message->data.assign(1000, 1);
  EXPECT_FALSE(copy.write(block.start()));
  EXPECT_TRUE(block.has_guard());
  message->data.clear();
  EXPECT_TRUE(copy.write(block.start()));
}

TEST(MessageCopy, BeginsWithTheHeader) {
  constexpr std::uint32_t header_bytes = 16;
  const MessageType type = type_of<PointCloud2>().behind_header(header_bytes, 1);
  struct Framed {
    std::byte header[header_bytes];
    PointCloud2 message;
  };
  const auto framed = std::make_unique<Framed>();
  std::memset(framed->header, 7, sizeof framed->header);
  framed->message.data.assign(100, 1);
  const detail::MessageCopy copy(type, &framed->message);
  const Block block(copy);
  ASSERT_TRUE(copy.write(block.start()));
  EXPECT_EQ(std::memcmp(block.start(), framed->header, header_bytes), 0);
  const auto& message =
      *std::launder(reinterpret_cast<const PointCloud2*>(block.start() + header_bytes));
  EXPECT_EQ(message, framed->message);
  EXPECT_TRUE(check_residency(type, &message, block.window()).is_resident());
}

TEST(MessageCopy, ServesNoTypeWithoutATable) {
  EXPECT_FALSE(detail::is_copied_into_block(type_of<Map>())) << "visited";
  EXPECT_FALSE(detail::is_copied_into_block(type_of<Opaque>()));
}

template <class T>
void random_message(std::uint64_t seed) {
  std::unique_ptr<T> original(RandomFiller(seed).make<T>());
  const std::unique_ptr<T> twin(RandomFiller(seed).make<T>());
  ASSERT_EQ(*original, *twin);
  expect_copy(std::move(original), *twin);
}

TEST(MessageCopy, OfRandomMessagesIsEqual) {
  for (std::uint64_t seed = 1; seed <= 300 && !testing::Test::HasFailure(); ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const std::int64_t live = heap_counters().live;
    random_message<PointCloud2>(seed);
    random_message<Forest>(seed);
    random_message<Everything>(seed);
    EXPECT_EQ(heap_counters().live, live) << "memory leaked";
  }
}

}  // namespace
}  // namespace test
}  // namespace agnocast
