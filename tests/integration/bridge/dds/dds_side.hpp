// SPDX-License-Identifier: Apache-2.0
//
// Helpers of both sides of the DDS tests: payloads that can be checked, a decoder that keeps the
// bytes, and waiting for the other side.
#pragma once

#include <bridge/dds/participant.hpp>
#include <bridge/dds/ros_graph.hpp>

#include <algorithm>
#include <chrono>
#include <string>
#include <vector>

namespace agnocast::test {

using bridge::DdsParticipant;
using bridge::DdsQos;
using bridge::DdsReader;
using bridge::DdsSample;
using bridge::DdsWriter;
using Bytes = std::vector<std::byte>;

constexpr auto patience = std::chrono::minutes(5);

struct Received {
  Bytes bytes;
  std::size_t pieces = 0;
};

inline std::shared_ptr<void> keep_bytes(bridge::RawPieces pieces) {
  auto received = std::make_shared<Received>();
  received->pieces = pieces.size();
  for (const auto piece : pieces)
    received->bytes.insert(received->bytes.end(), piece.begin(), piece.end());
  return received;
}

/// Returns an XCDR1 encapsulation, then `size` bytes that depend on their position.
inline Bytes pattern(std::size_t size) {
  Bytes bytes(4 + size);
  bytes[1] = std::byte{1};
  for (std::size_t i = 0; i < size; ++i) bytes[4 + i] = std::byte(i * 31 + i / 1344 + size);
  return bytes;
}

inline Bytes bytes_of(const std::string& hex) {
  Bytes bytes;
  for (std::size_t i = 0; i + 1 < hex.size(); i += 2)
    bytes.push_back(std::byte(std::stoi(hex.substr(i, 2), nullptr, 16)));
  return bytes;
}

inline bridge::DdsResult<bridge::WriteOutcome> send(DdsWriter& writer, const Bytes& bytes,
                                                    std::int64_t source_time_ns = 1) {
  return writer.write(
      bytes.size(),
      [&bytes](std::span<std::byte> to) {
        std::copy(bytes.begin(), bytes.end(), to.begin());
        return bytes.size();
      },
      source_time_ns);
}

/// "reliable", "transient", "all" and a depth in any order: "best 5", "reliable transient 1".
inline DdsQos qos_of(const std::string& words) {
  DdsQos qos;
  qos.reliable = words.find("best") == std::string::npos;
  qos.transient_local = words.find("transient") != std::string::npos;
  qos.keep_all = words.find("all") != std::string::npos;
  const std::size_t depth = words.find_first_of("0123456789");
  if (depth != std::string::npos) qos.depth = std::stoi(words.substr(depth));
  return qos;
}

/// Waits and collects discovery until `done()`; returns false after a timeout.
template <class Done>
bool until(DdsParticipant& participant, const Done& done,
           std::vector<bridge::RemoteChange>* changes = nullptr) {
  const auto end = std::chrono::steady_clock::now() + patience;
  while (std::chrono::steady_clock::now() < end) {
    for (const auto& change : participant.discovered())
      if (changes != nullptr) changes->push_back(change);
    if (done()) return true;
    if (!participant.wait(std::chrono::milliseconds(50))) return false;
  }
  return false;
}

/// Returns the next sample with data.
inline std::optional<DdsSample> next(DdsParticipant& participant, DdsReader& reader) {
  std::optional<DdsSample> sample;
  until(participant, [&] {
    sample = reader.take();
    return sample && sample->state == DdsSample::State::valid;
  });
  return sample;
}
inline const Received& received(const DdsSample& sample) {
  return *static_cast<const Received*>(sample.object.get());
}

}  // namespace agnocast::test
