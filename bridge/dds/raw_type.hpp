// SPDX-License-Identifier: Apache-2.0
//
// Raw samples: the samples of a topic of any type, keyless, as XCDR1 bytes. Cyclone DDS knows a
// type by a table of functions; the one here neither serializes nor deserializes.
//
//   written    fill(buffer) ── the only pass over the bytes ──▶ sample ──▶ packets
//   received   fragments, where the packets left them ──▶ decoder(pieces) ──▶ object ──▶ reader's cache
//
// So a message goes from its own memory straight into the sample, and from the fragments straight
// to the decoder's target. This file does not look into the bytes, not even the encapsulation.
//
// It announces the same as rmw_cyclonedds: no type information, and XCDR1 as the only
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

/// The pieces of one payload, in order: encapsulation (whole in the first), then the rest. They
/// lie in packets and are gone after the call.
using RawPieces = std::span<const std::span<const std::byte>>;

/// Converts a payload to the object that the reader takes. Null or an exception refuses it, except
/// std::bad_alloc, which drops it uncounted. Threads of Cyclone DDS call it, possibly several at
/// once, while they hold locks: it must not call Cyclone DDS and should not wait.
using RawDecoder = std::function<std::shared_ptr<void>(RawPieces)>;

/// Writes a payload from its first byte on and returns its size. 0, more than there is room for,
/// or an exception: nothing is sent. The memory is not zeroed.
using RawFill = std::function<std::size_t(std::span<std::byte>)>;

/// Shared by all readers of a participant. Any thread.
struct RawShared {
  Limits limits;
  std::atomic<std::uint64_t> unread_bytes{0};
};

/// Counters of a type, for its reader. Any thread. Unread bytes are decoded and lie in the
/// reader's cache; beyond Limit::unread_bytes_of_reader and Limit::unread_bytes nothing is
/// decoded.
struct RawCounts {
  explicit RawCounts(std::shared_ptr<RawShared> all,
                     std::size_t most = most_of(Limit::unread_bytes_of_reader))
      : shared(std::move(all)), unread_bytes_max(most) {}

  std::atomic<std::uint64_t> decoded{0};
  std::atomic<std::uint64_t> refused{0};   // by the decoder, or incomplete
  std::atomic<std::uint64_t> overflow{0};  // over a limit
  std::atomic<std::uint64_t> unread_bytes{0};
  const std::shared_ptr<RawShared> shared;
  const std::size_t unread_bytes_max;
};

/// Returns a type of that name with one reference, for dds_create_topic_sertype(). No two are
/// equal, so each topic keeps its own decoder. Without a decoder every payload is refused. Throws
/// std::bad_alloc.
ddsi_sertype* make_raw_type(const std::string& name, RawDecoder decoder,
                            std::shared_ptr<RawCounts> counts);

/// Returns a sample to be written, with one reference, padded with zeros to a multiple of 4. Null
/// if `fill` refused, if `size` is 0 or more than DDS carries (4 GiB), or if there is no memory.
ddsi_serdata* make_raw_sample(const ddsi_sertype& type, std::size_t size, const RawFill& fill,
                              std::int64_t source_time_ns) noexcept;

/// Returns the decoder's object of a received sample; null if it was refused or has no data.
std::shared_ptr<void> object_of(const ddsi_serdata& sample) noexcept;

}  // namespace agnocast::bridge
