// SPDX-License-Identifier: Apache-2.0
//
// Goal: a relay writes (CDR) or copies only bytes inside the publisher's heap windows, touches no
// unmapped memory, and does no more work than the size of the windows justifies. Method: messages
// whose strings and sequences are set word by word, in memory that stands for the windows; next to
// it lie secret bytes of another owner, and an unreadable page.

#include <agnocast/relay.hpp>
#include <bridge/cdr/cdr.hpp>
#include <tests/support/schema_tables.hpp>

#include <gtest/gtest.h>
#include <sys/mman.h>

#include <array>
#include <cstring>
#include <string>
#include <string_view>
#include <vector>

namespace agnocast::bridge {
namespace {

/// The layouts of libstdc++.
struct RawString {
  const void* data = nullptr;
  std::size_t size = 0;
  char local[16] = {};
};
static_assert(sizeof(RawString) == sizeof(std::string));
struct RawVector {
  const void *begin = nullptr, *end = nullptr, *storage = nullptr;
};
struct RawBits {
  const void* begin = nullptr;
  unsigned begin_offset = 0;
  const void* end = nullptr;
  unsigned end_offset = 0;
  const void* storage = nullptr;
};
static_assert(sizeof(RawBits) == sizeof(std::vector<bool>));

const test::Schema schema{
    {"relay/msg/Text", {{"data", "string"}}},
    {"relay/msg/Data", {{"data", "uint8[]"}, {"labels", "relay/msg/Label[]"}}},
    {"relay/msg/Label", {{"text", "string"}, {"size", "uint32"}}},
    {"relay/msg/Bits", {{"values", "bool[]"}}},
    {"relay/msg/All",
     {{"text", "string"},
      {"wide", "wstring"},
      {"numbers", "float64[]"},
      {"bits", "bool[]"},
      {"no_numbers", "float64[]"},
      {"no_bits", "bool[]"},
      {"texts", "string[]"},
      {"label", "relay/msg/Label"}}}};

class Relay : public testing::Test {
 protected:
  static constexpr std::size_t window_bytes = 1 << 20, secret_bytes = 4096;

  Relay() {
    void* const at = ::mmap(nullptr, window_bytes + 3 * secret_bytes, PROT_READ | PROT_WRITE,
                            MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    window_ = static_cast<std::byte*>(at);
    secret_ = window_ + window_bytes;
    std::memset(secret_, 's', secret_bytes);
    EXPECT_EQ(::mprotect(secret_ + secret_bytes, secret_bytes, PROT_NONE), 0);
    EXPECT_TRUE(windows_.add(reinterpret_cast<std::uintptr_t>(window_),
                             reinterpret_cast<std::uintptr_t>(window_) + window_bytes));
  }
  ~Relay() override { ::munmap(window_, window_bytes + 3 * secret_bytes); }

  /// Makes a default message at the beginning of the window; it is not destroyed.
  void begin(const std::string& type) {
    members_ = &test::members_of_schema(schema, type);
    std::memset(window_, 0, members_->size_of_);
    members_->init_function(window_, rosidl_runtime_cpp::MessageInitialization::ALL);
  }
  template <class Raw>
  void set(std::string_view name, const Raw& raw) {
    std::memcpy(window_ + offset_of(name), &raw, sizeof raw);
  }
  std::size_t offset_of(std::string_view name) const {
    for (std::uint32_t i = 0; i < members_->member_count_; ++i) {
      if (members_->members_[i].name_ == name) return members_->members_[i].offset_;
    }
    ADD_FAILURE() << "no member " << name;
    return 0;
  }
  /// Returns whether both ways relay the message; then `written_` has the bytes.
  bool passes() {
    const CdrType type = CdrType::of(*members_).value();
    const std::size_t bytes = cdr_bytes(type, window_, &windows_);
    written_.assign(std::max<std::size_t>(bytes, 64), std::byte{0});
    const auto written = write_cdr(type, window_, written_, &windows_);
    EXPECT_EQ(written.has_value(), bytes != 0);
    if (written) {
      EXPECT_EQ(*written, bytes);
    } else {
      EXPECT_TRUE(written.error().reason == CdrReason::elsewhere ||
                  written.error().reason == CdrReason::no_room)
          << written.error().text();
    }
    for (std::size_t i = 0; i + 8 <= written_.size(); ++i)
      EXPECT_NE(std::memcmp(written_.data() + i, "ssssssss", 8), 0) << "a secret was written";
    OwnedGenericMessage copy = agnocast::detail::CodeByTable{members_}.make();
    agnocast::detail::CheckedCopy checked(windows_);
    const bool copied = checked.take(window_, members_->size_of_) &&
                        checked.message(*members_, window_, copy.get());
    EXPECT_EQ(copied, bytes != 0);
    return bytes != 0;
  }
  bool passes_string(const void* data, std::size_t size) {
    set("data", RawString{data, size, {}});
    return passes();
  }

  std::byte *window_, *secret_;
  WindowSet windows_;
  const MessageMembers* members_ = nullptr;
  std::vector<std::byte> written_;
};

TEST_F(Relay, PassesOnlyStringsInThePublishersMemory) {
  begin("relay/msg/Text");
  EXPECT_TRUE(passes());
  std::memcpy(window_ + 4096, "honest", 6);
  EXPECT_TRUE(passes_string(window_ + 4096, 6));
  EXPECT_EQ(std::memcmp(written_.data() + 8, "honest", 6), 0);
  EXPECT_TRUE(passes_string(window_ + window_bytes - 8, 8)) << "up to the last byte";
  EXPECT_TRUE(passes_string(window_ + offset_of("data") + 16, 15))
      << "short, within the string itself";
  EXPECT_FALSE(passes_string(secret_, 8));
  EXPECT_FALSE(passes_string(window_ + window_bytes - 8, 9)) << "one byte outside the window";
  EXPECT_FALSE(passes_string(secret_ + secret_bytes, 8)) << "not readable";
  EXPECT_FALSE(passes_string(nullptr, 8));
  EXPECT_FALSE(passes_string(reinterpret_cast<const void*>(~std::uintptr_t{0} - 3), 8));
  EXPECT_FALSE(passes_string(window_ + 4096, ~std::size_t{0}));
  EXPECT_FALSE(passes_string(window_ + 4096, ~std::size_t{0} / 2));
  EXPECT_FALSE(passes_string(window_ + 4096, window_bytes));
}

TEST_F(Relay, PassesOnlySequencesInThePublishersMemory) {
  begin("relay/msg/Data");
  const auto passes_vector = [&](const std::byte* first, const std::byte* end) {
    set("data", RawVector{first, end, end});
    return passes();
  };
  EXPECT_TRUE(passes_vector(window_ + 4096, window_ + 8192));
  EXPECT_FALSE(passes_vector(secret_, secret_ + 64));
  EXPECT_FALSE(passes_vector(window_ + window_bytes - 64, secret_ + 1));
  EXPECT_FALSE(passes_vector(window_ + 8192, window_ + 4096)) << "backwards";
  EXPECT_FALSE(passes_vector(nullptr, window_ + 4096));
  EXPECT_FALSE(passes_vector(secret_ + secret_bytes, secret_ + secret_bytes + 1));
}

// If every element of a sequence had the same megabyte as its label, the copy would be gigabytes.
TEST_F(Relay, DoesNoMoreWorkThanTheWindowSizeJustifies) {
  begin("relay/msg/Data");
  const MessageMembers& of_label = test::members_of_schema(schema, "relay/msg/Label");
  constexpr std::size_t count = 1000;
  std::byte* const elements = window_ + 4096;
  for (std::size_t i = 0; i < count; ++i) {
    const RawString label{window_ + window_bytes / 2, 1000, {}};
    std::memcpy(elements + i * of_label.size_of_ + of_label.members_[0].offset_, &label,
                sizeof label);
  }
  const auto set_labels = [&](std::size_t some) {
    const RawVector all{elements, elements + some * of_label.size_of_, nullptr};
    set("labels", all);
  };
  set_labels(100);
  EXPECT_TRUE(passes());
  set_labels(count);
  EXPECT_TRUE(passes()) << "a thousand times a thousand is less than the window";
  for (std::size_t i = 0; i < count; ++i) {
    const RawString label{window_ + window_bytes / 2, window_bytes / 2, {}};
    std::memcpy(elements + i * of_label.size_of_ + of_label.members_[0].offset_, &label,
                sizeof label);
  }
  EXPECT_FALSE(passes());
}

TEST_F(Relay, PassesOnlyBitsInThePublishersMemory) {
  begin("relay/msg/Bits");
  const auto passes_bits = [&](const RawBits& bits) {
    set("values", bits);
    return passes();
  };
  std::byte* const words = window_ + 8192;
  EXPECT_TRUE(passes_bits({words, 0, words + 8, 3, words + 16}));
  EXPECT_TRUE(passes_bits({words, 0, words + 8, 0, words + 8}));
  EXPECT_FALSE(passes_bits({secret_, 0, secret_ + 8, 0, secret_ + 8}));
  EXPECT_FALSE(passes_bits({window_ + window_bytes - 8, 0, secret_, 1, secret_ + 8}));
  EXPECT_FALSE(passes_bits({words, 0, words + 8, 64, words + 8})) << "bit 64 is outside the word";
  EXPECT_TRUE(passes_bits({words, 64 * 100 - 1, words + 800, 0, words + 800}))
      << "libstdc++ ignores the bit offset of a vector's beginning";
  EXPECT_FALSE(passes_bits({words, 0, words + 800, ~0U, words + 800}));
  EXPECT_FALSE(passes_bits({words + 800, 0, words, 1, words}));
  // A part of a word counts as no word, but libstdc++ makes bits of it.
  const auto* const parts = reinterpret_cast<const std::byte*>(std::uintptr_t{1});
  EXPECT_FALSE(passes_bits({nullptr, 0, parts, 0, parts}));
  EXPECT_FALSE(passes_bits({words, 0, words + 1, 0, words + 8}));
  EXPECT_FALSE(passes_bits({words + 1, 0, words + 9, 0, words + 16}));
}

TEST_F(Relay, PassesNoLieOfASingleWord) {
  begin("relay/msg/All");
  std::byte* const inside = window_ + 8192;
  set("text", RawString{inside, 20, {}});
  set("wide", RawString{inside + 64, 20, {}});
  set("numbers", RawVector{inside + 128, inside + 256, inside + 256});
  set("bits", RawBits{inside + 256, 0, inside + 264, 3, inside + 264});
  ASSERT_TRUE(passes());
  const std::vector<std::byte> truth(window_, window_ + members_->size_of_);
  int refused = 0;
  for (std::size_t at = 0; at + 8 <= truth.size(); at += 8) {
    std::uint64_t word = 0;
    std::memcpy(&word, truth.data() + at, sizeof word);
    const auto secret = reinterpret_cast<std::uint64_t>(secret_);
    for (const std::uint64_t lie :
         {std::uint64_t{0}, std::uint64_t{1}, std::uint64_t{7}, ~std::uint64_t{0}, word + 1,
          word - 1, word + 8, word - 8, word + (std::uint64_t{1} << 32), ~word, secret, secret - 1,
          secret + secret_bytes, reinterpret_cast<std::uint64_t>(window_)}) {
      SCOPED_TRACE(testing::Message() << "byte " << at << ": " << lie);
      std::memcpy(window_, truth.data(), truth.size());
      std::memcpy(window_ + at, &lie, sizeof lie);
      if (!passes()) ++refused;
    }
  }
  EXPECT_GT(refused, 50);
}

TEST_F(Relay, PassesNothingOfAMessageOutsideTheWindows) {
  begin("relay/msg/Text");
  const CdrType type = CdrType::of(*members_).value();
  EXPECT_EQ(cdr_bytes(type, secret_, &windows_), 0u);
  const WindowSet none;
  EXPECT_EQ(cdr_bytes(type, window_, &none), 0u);
  EXPECT_NE(cdr_bytes(type, window_), 0u) << "a message of this process";
}

}  // namespace
}  // namespace agnocast::bridge
