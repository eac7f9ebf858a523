// SPDX-License-Identifier: Apache-2.0
//
// Pair: a publisher and subscriptions over plain memory; shared by the tests of the data plane.
#pragma once

#include <dataplane/publisher_core.hpp>
#include <dataplane/subscription_core.hpp>
#include <journal/board_steps.hpp>
#include <journal/queue_recovery.hpp>
#include <tests/support/memory/aligned_region.hpp>

#include <gtest/gtest.h>

#include <cstdint>
#include <cstdio>
#include <functional>
#include <iterator>
#include <memory>
#include <random>
#include <set>
#include <string>
#include <tuple>
#include <vector>

namespace agnocast::dataplane {

using M = SharedMemory;

inline constexpr std::uint64_t extent = abi::page_bytes;
inline constexpr std::uint64_t generation = 9;

using Region = test::AlignedRegion;

/// A heap window of 1 MiB that exists only as numbers.
struct NumberWindow {
  std::uint64_t base = 0x100000;
  std::uint64_t bytes = 1 << 20;
  void open() const {}
  bool contains(std::uint64_t address, std::uint64_t size) const {
    return address >= base && size <= bytes && address - base <= bytes - size;
  }
  region::Place place_of(std::uint64_t address, std::uint64_t size) const {
    return contains(address, size) ? region::Place::readable : region::Place::outside;
  }
};

struct Pair {
  Region board{abi::topic_bytes}, publisher, subscriber[2];
  abi::Qos offered{4, false, true, false, false};
  abi::Qos requested{8, false, true, false, false};

  static std::uint64_t first() { return abi::first_sequence_of(generation); }
  region::TopicWords<M> topic() { return {board.base(), 0}; }
  region::PublisherWords<M> words() { return {publisher.base(), extent}; }
  region::LinkWords<M> line(std::uint64_t s) { return {subscriber[s].base(), extent, 0}; }
  LinkCore<M> link(std::uint64_t s) {
    return LinkCore<M>(
        {topic(), words(), line(s), 0, generation, first(), offered, requested, 0, 8, s});
  }
  Pair() {
    words().head().store(abi::pack_entry(first(), 0));
    journal::BoardSteps<M>(topic()).add_publisher(0, generation, {offered, 0, extent, 64});
  }
};

inline std::uint64_t nasty(std::mt19937_64& random) {
  switch (random() % 8) {
    case 0:
      return 0;
    case 1:
      return ~std::uint64_t{0};
    case 2:
      return abi::retired_mark | random();
    case 3:
      return abi::pack_entry(Pair::first() + random() % 5000, random() % 0x10000);
    case 4:
      return Pair::first() + random() % 5000;
    case 5:
      return std::uint64_t{1} << random() % 64;
    default:
      return random();
  }
}

struct Freed {
  std::set<std::uint64_t> live;
  void ring(std::uint64_t, std::uint64_t) {}
  void freed(std::uint64_t, std::uint64_t address) {
    EXPECT_EQ(live.erase(address), 1u) << "freed an address that was not allocated";
  }
};

}  // namespace agnocast::dataplane
