// SPDX-License-Identifier: Apache-2.0
//
// Raw samples: what DDS carries for a topic of any type, keyless, as the bytes of its XCDR1 form.
// Cyclone DDS is told of a type by a table of functions; this one neither serializes nor
// deserializes.
//
//   written    fill(buffer) ── the only pass over the bytes ──▶ sample ──▶ packets
//   received   fragments, where the packets left them ──▶ decoder(pieces) ──▶ object ──▶ reader's cache
//
// So a message goes from its own memory straight into the sample, and from the fragments straight
// to where the decoder wants it. Nothing here looks into the bytes, the encapsulation included.
//
// Announced is what rmw_cyclonedds announces: no type information, and XCDR1 as the only
// representation, which is the default and therefore not written. Used by participant.cpp;
// Cyclone's headers stay behind this one.
#pragma once

#include <bridge/dds/limits.hpp>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <utility>

struct ddsi_sertype;
struct ddsi_serdata;

namespace agnocast::bridge {

/// The pieces of one payload, in order: encapsulation (whole in the first), then what follows. They
/// lie in packets and are gone after the call.
using RawPieces = std::span<const std::span<const std::byte>>;

/// Makes of a payload what the reader takes; null or an exception refuses it, but for std::bad_alloc,
/// by which it is dropped uncounted. Called by threads of Cyclone DDS, possibly by several at the same
/// time, while they hold locks: must not call Cyclone DDS and should not wait.
using RawDecoder = std::function<std::shared_ptr<void>(RawPieces)>;

/// Writes a payload from its first byte on and returns how many bytes it has; 0, more than there is
/// room for, or an exception: nothing is sent. The memory is not zeroed.
using RawFill = std::function<std::size_t(std::span<std::byte>)>;

/// What all readers of a participant have together. Any thread.
struct RawShared {
  Limits limits;
  std::atomic<std::uint64_t> unread_bytes{0};
};

/// What a type counts, for its reader. Any thread. Unread is what was decoded and lies in the reader's cache; beyond
/// Limit::unread_bytes_of_reader and Limit::unread_bytes nothing is decoded.
struct RawCounts {
  explicit RawCounts(std::shared_ptr<RawShared> all,
                     std::size_t most = most_of(Limit::unread_bytes_of_reader))
      : shared(std::move(all)), unread_bytes_max(most) {}

  std::atomic<std::uint64_t> decoded{0};
  std::atomic<std::uint64_t> refused{0};   // by the decoder, or incomplete
  std::atomic<std::uint64_t> overflow{0};  // beyond a limit
  std::atomic<std::uint64_t> unread_bytes{0};
  const std::shared_ptr<RawShared> shared;
  const std::size_t unread_bytes_max;
};

/// A type of that name with one reference, for dds_create_topic_sertype. No two are equal, so each
/// topic keeps the decoder it was made with. Without a decoder every payload is refused. Throws
/// std::bad_alloc.
ddsi_sertype* make_raw_type(const std::string& name, RawDecoder decoder,
                            std::shared_ptr<RawCounts> counts);

/// A sample to be written, with one reference; zeros follow what was filled, up to a multiple of 4.
/// Null if `fill` refused, if `size` is 0 or more than DDS carries (4 GiB), or if there is no
/// memory.
ddsi_serdata* make_raw_sample(const ddsi_sertype& type, std::size_t size, const RawFill& fill,
                              std::int64_t source_time_ns) noexcept;

/// What the decoder made of a sample that was received; null if it refused, and for a sample
/// without data.
std::shared_ptr<void> object_of(const ddsi_serdata& sample) noexcept;

}  // namespace agnocast::bridge
