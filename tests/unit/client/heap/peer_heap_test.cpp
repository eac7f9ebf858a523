// SPDX-License-Identifier: Apache-2.0
//
// Goal: a message is readable only if everything it may point to is: all windows of its window set
// are announced and mapped up to the frontier. Method: windows of memfds in a reservation of this
// test, which writes the owner's header as an owner would, honest or not.

#include <base/descriptors/kept_fd.hpp>
#include <base/memory/mapping.hpp>
#include <base/memory/memfd.hpp>
#include <client/heap/address_users.hpp>
#include <client/heap/peer_heap.hpp>
#include <tests/support/memory/aligned_region.hpp>

#include <agnocast/abi/client_region.hpp>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <string>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using region::Place;

constexpr std::uint64_t window_bytes = 4 << 20;

class PeerHeapTest : public testing::Test {
 protected:
  std::uint64_t base_of(std::uint64_t window) const {
    return reinterpret_cast<std::uint64_t>(arena_.base()) + window * window_bytes;
  }
  abi::WindowEntry& shown(std::uint64_t window) {
    return reinterpret_cast<abi::ClientRegionHeader*>(header_.base())->window[window];
  }
  /// As the owner does before it allocates there.
  void show(std::uint64_t window, std::uint64_t frontier) {
    shown(window).length.store(window_bytes);
    shown(window).frontier.store(frontier);
    shown(window).base.store(base_of(window));
  }
  PeerHeap::Announced announced(std::uint64_t window, std::uint64_t first) const {
    return {window, base_of(window), window_bytes, first};
  }
  void add(std::uint64_t window, std::uint64_t first) {
    ASSERT_TRUE(heap_.add(announced(window, first), make_memfd("window", window_bytes).value()));
  }
  Place place_of(std::uint64_t window, std::uint64_t offset = 0, std::uint64_t size = 64) {
    HeapLook look(heap_, others_);
    look.open();
    return look.place_of(base_of(window) + offset, size);
  }

  Mapping arena_ = Mapping::reserve(0, 8 * window_bytes).value();
  test::AlignedRegion header_{abi::page_bytes};
  PeerHeap heap_{header_.base()};
  Unannounced others_ = Unannounced::awaited;
};

TEST_F(PeerHeapTest, TakesBehindOneHeadLookOnceUnlessAWindowIsAwaited) {
  std::uint64_t head = 1;
  HeapLook look(heap_, Unannounced::awaited, head);
  const auto place_at = [&](std::uint64_t address) {
    look.open();
    return look.place_of(address, 64);
  };
  show(0, abi::page_bytes);
  add(0, 0);
  EXPECT_EQ(place_at(base_of(0)), Place::readable);
  show(0, 2 * abi::page_bytes);
  EXPECT_EQ(place_at(base_of(0) + abi::page_bytes - 64), Place::readable);
  head = 2;
  EXPECT_EQ(place_at(base_of(0) + abi::page_bytes), Place::readable)
      << "the take must have looked again";
  show(1, abi::page_bytes);
  EXPECT_EQ(place_at(base_of(0)), Place::readable) << "messages behind that head lie elsewhere";
  head = 3;
  EXPECT_EQ(place_at(base_of(0)), Place::awaited);
  EXPECT_EQ(place_at(base_of(1)), Place::awaited);
  add(1, 0);
  EXPECT_EQ(place_at(base_of(1)), Place::readable) << "although the head is the same";
  EXPECT_EQ(place_at(base_of(0)), Place::readable) << "in the other window";
}

TEST_F(PeerHeapTest, AWindowAnnouncedAfterALookIsSeenAtTheSameHead) {
  const std::uint64_t head = 1;
  HeapLook look(heap_, Unannounced::awaited, head);
  show(0, abi::page_bytes);  // one window set of one window, and one of two
  show(1, abi::page_bytes);
  show(2, abi::page_bytes);
  add(0, 0);
  add(1, 1);
  look.open();
  ASSERT_EQ(look.place_of(base_of(0), 64), Place::readable);
  add(2, 1);
  // A take counts the windows before it looks: it must not miss the window that it waits for.
  look.open();
  EXPECT_EQ(look.place_of(base_of(1), 64), Place::readable);
}

TEST_F(PeerHeapTest, NothingBehindTheEndOfTheFileIsOpenedWhateverTheOwnerWrites) {
  UniqueFd file = make_memfd("window", 2 * abi::page_bytes, Length::may_grow).value();
  const int owner = file.get();
  UniqueFd reader = reopen_read_only(owner).value();
  show(0, window_bytes);
  ASSERT_TRUE(heap_.add(announced(0, 0), std::move(reader)));
  EXPECT_EQ(place_of(0, abi::page_bytes), Place::readable);
  EXPECT_EQ(place_of(0, 2 * abi::page_bytes - 63), Place::outside);
  EXPECT_EQ(place_of(0, 2 * abi::page_bytes), Place::outside);
  ASSERT_TRUE(lengthen(owner, 4 * abi::page_bytes - 8));
  EXPECT_EQ(place_of(0, 2 * abi::page_bytes), Place::readable);
  EXPECT_EQ(place_of(0, 3 * abi::page_bytes), Place::outside) << "only whole pages are opened";
  ASSERT_TRUE(lengthen(owner, window_bytes));
  EXPECT_EQ(place_of(0, window_bytes - 64), Place::readable);
  const auto* const last =
      reinterpret_cast<const volatile unsigned char*>(base_of(0)) + (window_bytes - 1);
  const unsigned value = *last;
  EXPECT_EQ(value, 0u) << "open memory can be read";
}

TEST_F(PeerHeapTest, AWindowIsReadableUpToItsFrontier) {
  show(0, abi::page_bytes);
  add(0, 0);
  EXPECT_EQ(place_of(0), Place::readable);
  EXPECT_EQ(place_of(0, abi::page_bytes - 64), Place::readable);
  EXPECT_EQ(place_of(0, abi::page_bytes - 63), Place::outside);
  EXPECT_EQ(place_of(0, window_bytes - 8), Place::outside);
  EXPECT_EQ(place_of(0, 0, ~std::uint64_t{0}), Place::outside);
  EXPECT_EQ(place_of(3), Place::outside);
  EXPECT_EQ(heap_.place_of(0, 8, 1, Unannounced::awaited), Place::outside);
  EXPECT_EQ(heap_.place_of(~std::uint64_t{0}, 8, 1, Unannounced::awaited), Place::outside);
  shown(0).frontier.store(~std::uint64_t{0});  // a lie: clamped to the length
  EXPECT_EQ(place_of(0, window_bytes - 64), Place::readable);
  EXPECT_EQ(place_of(0, window_bytes - 63), Place::outside);
  EXPECT_EQ(*reinterpret_cast<const char*>(base_of(0) + window_bytes - 1), 0);
}

// publish() asks this about a message of its caller.
TEST_F(PeerHeapTest, AnAddressGivesTheOpenWindowsOfItsSet) {
  AddressUsers& users = AddressUsers::instance();
  show(0, abi::page_bytes);  // one window set of one window, and one of two
  show(1, 2 * abi::page_bytes);
  show(2, 3 * abi::page_bytes);
  add(0, 0);
  add(1, 1);
  add(2, 1);
  EXPECT_EQ(users.window_set_of_another(base_of(1)).count(), 0u) << "nothing is open";
  heap_.open();
  for (const std::uint64_t window : {1u, 2u}) {
    EXPECT_TRUE(users.may_be_of_another(base_of(window)));
    const WindowSet window_set = users.window_set_of_another(base_of(window) + 100);
    ASSERT_EQ(window_set.count(), 2u);
    EXPECT_EQ(window_set[0].begin, base_of(1));
    EXPECT_EQ(window_set[0].end, base_of(1) + 2 * abi::page_bytes);
    EXPECT_EQ(window_set[1].begin, base_of(2));
    EXPECT_EQ(window_set[1].end, base_of(2) + 3 * abi::page_bytes);
  }
  EXPECT_EQ(users.window_set_of_another(base_of(0)).count(), 1u);
  EXPECT_EQ(users.window_set_of_another(base_of(3)).count(), 0u);
  EXPECT_EQ(users.window_set_of_another(0).count(), 0u);
  EXPECT_FALSE(users.may_be_of_another(0));
  ASSERT_TRUE(users.enter(base_of(4), window_bytes, {}, AddressUsers::own));
  users.mapped(base_of(4), abi::page_bytes);
  EXPECT_EQ(users.window_set_of_another(base_of(4)).count(), 0u) << "this process's own";
  users.leave(base_of(4));
}

TEST_F(PeerHeapTest, AMessageThatMayPointIntoAnUnannouncedWindowIsAwaited) {
  show(0, abi::page_bytes);
  add(0, 0);
  show(1, abi::page_bytes);
  EXPECT_EQ(place_of(1), Place::awaited);
  EXPECT_EQ(place_of(0), Place::awaited) << "its members may lie in window 1";
  add(1, 0);
  EXPECT_EQ(heap_.place_of(base_of(0), 64, 1, Unannounced::awaited), Place::awaited)
      << "added, but not opened yet";
  EXPECT_EQ(place_of(0), Place::readable);
  EXPECT_EQ(place_of(1), Place::readable);
}

TEST_F(PeerHeapTest, NothingIsAwaitedFromAGonePublisher) {
  show(0, abi::page_bytes);
  add(0, 0);
  show(1, abi::page_bytes);
  others_ = Unannounced::ignored;
  EXPECT_EQ(place_of(0), Place::readable);
  EXPECT_EQ(place_of(1), Place::outside);
}

TEST_F(PeerHeapTest, AMessageThatMayPointIntoALostWindowIsNotRead) {
  show(0, abi::page_bytes);
  add(0, 0);
  others_ = Unannounced::lost;
  EXPECT_EQ(place_of(0), Place::readable) << "there is no other window";
  show(1, abi::page_bytes);
  EXPECT_EQ(place_of(0), Place::unreachable) << "its members may lie in window 1";
  EXPECT_EQ(place_of(1), Place::unreachable);
}

TEST_F(PeerHeapTest, NothingInAWindowSetWithAClosedWindowIsRead) {
  show(0, abi::page_bytes);
  show(1, abi::page_bytes);
  add(0, 0);
  ASSERT_TRUE(heap_.add_blocked(announced(1, 0)));
  EXPECT_EQ(place_of(0), Place::unreachable);
  EXPECT_EQ(place_of(1), Place::unreachable);
  EXPECT_EQ(heap_.window_count(), 2u);
}

TEST_F(PeerHeapTest, OtherWindowSetsAreReadBesideOneWithAClosedWindow) {
  show(0, abi::page_bytes);
  ASSERT_TRUE(heap_.add_blocked(announced(0, 0)));
  EXPECT_EQ(place_of(0), Place::unreachable);
  show(1, abi::page_bytes);
  EXPECT_EQ(place_of(1), Place::awaited);
  add(1, 1);
  show(2, abi::page_bytes);
  add(2, 1);
  EXPECT_EQ(place_of(0), Place::unreachable);
  EXPECT_EQ(place_of(1), Place::readable);
  EXPECT_EQ(place_of(2), Place::readable);
  show(3, abi::page_bytes);
  EXPECT_EQ(place_of(0), Place::unreachable) << "its window set is complete: nothing is awaited";
  EXPECT_EQ(place_of(2), Place::awaited);
}

TEST_F(PeerHeapTest, AFailedMappingClosesTheWindowSet) {
  show(0, abi::page_bytes);
  add(0, 0);
  show(1, abi::page_bytes);
  const UniqueFd file = make_memfd("window", window_bytes).value();
  const std::string path = "/proc/self/fd/" + std::to_string(file.get());
  ASSERT_TRUE(heap_.add(announced(1, 0), UniqueFd(::open(path.c_str(), O_WRONLY | O_CLOEXEC))));
  EXPECT_EQ(place_of(0), Place::unreachable);
}

// A program may close descriptors that it did not open, and reuse the number for its own.
TEST_F(PeerHeapTest, AFileThatTookAWindowsDescriptorNumberIsNotMapped) {
  UniqueFd file = keep(make_memfd("window", window_bytes).value());
  const int number = file.get();
  show(0, abi::page_bytes);
  ASSERT_TRUE(heap_.add(announced(0, 0), std::move(file)));
  ASSERT_EQ(place_of(0), Place::readable);
  const UniqueFd strange = make_memfd("strange", window_bytes).value();
  ASSERT_EQ(::dup2(strange.get(), number), number);
  show(0, 2 * abi::page_bytes);
  EXPECT_EQ(place_of(0), Place::unreachable);
}

TEST_F(PeerHeapTest, RefusesImpossibleAnnouncements) {
  EXPECT_FALSE(heap_.add_blocked(announced(1, 0))) << "window 0 must come first";
  EXPECT_FALSE(heap_.add_blocked(announced(0, 1)))
      << "the first window of a set has no higher index than the others";
  EXPECT_FALSE(heap_.add_blocked({0, 4097, window_bytes, 0}));
  EXPECT_FALSE(heap_.add_blocked({0, ~std::uint64_t{0} / 4096 * 4096, window_bytes, 0}));
  ASSERT_TRUE(heap_.add_blocked(announced(0, 0)));
  EXPECT_TRUE(heap_.add_blocked(announced(0, 0))) << "a repeated announcement is accepted";
  EXPECT_EQ(heap_.window_count(), 1u);
}

}  // namespace
}  // namespace agnocast
