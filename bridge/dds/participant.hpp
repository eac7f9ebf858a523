// SPDX-License-Identifier: Apache-2.0
//
// DdsParticipant: this process in a DDS domain, in the way of a ROS 2 context: one participant,
// writers and readers of raw samples by topic and type name, and a view of the entities of other
// participants.
//
//   DdsParticipant ─┬─ DdsWriter   write(size, fill)            any thread
//                   ├─ DdsReader   take() returns what its decoder made
//                   ├─ discovered()  entities that came, changed or went
//                   └─ wait()      one waitset for all of these; interrupt() ends it from any thread
//
// This class creates no thread. Cyclone DDS has its own: they receive, call decoders and send lost
// samples again. Everything except DdsWriter::write() and interrupt() belongs to one thread.
// Endpoints keep the participant alive, so the order of destruction is free.
//
// Names and QoS that others announce are input: they are copied and must be checked before use.
// Entities beyond a limit (limits.hpp) are not tracked: remotes() does not contain them, and their
// samples come from an unknown writer.
#pragma once

#include <bridge/dds/raw_type.hpp>

#include <tl/expected.hpp>

#include <array>
#include <chrono>
#include <compare>
#include <cstdint>
#include <cstring>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <unordered_map>
#include <vector>

namespace agnocast::bridge {

/// An operation that Cyclone DDS refused.
struct DdsFailure {
  std::int32_t code = 0;  ///< one of DDS_RETCODE_…, negative
  const char* what = "";  ///< static text: the operation

  std::string text() const;  ///< "create a writer: Bad Parameter"
};
template <class T>
using DdsResult = tl::expected<T, DdsFailure>;

/// Names a participant, a reader or a writer on the network. The first 12 bytes identify the
/// participant.
struct Guid {
  std::array<std::uint8_t, 16> bytes{};

  // clang-tidy 14 takes the zero behind <=> for a pointer. NOLINTNEXTLINE(modernize-use-nullptr)
  auto operator<=>(const Guid&) const = default;
  bool is_of_participant(const Guid& participant) const noexcept {
    return std::memcmp(bytes.data(), participant.bytes.data(), 12) == 0;
  }
  bool is_known() const noexcept { return *this != Guid{}; }
};
struct GuidHash {
  std::size_t operator()(const Guid& guid) const noexcept;
};

/// Quality of service as ROS 2 uses it. The default is that of an rclcpp endpoint with depth 1.
/// Endpoints match by the rules of DDS; blocking_max does not affect matching.
struct DdsQos {
  static constexpr std::chrono::nanoseconds infinite = std::chrono::nanoseconds::max();

  bool keep_all = false;
  std::int32_t depth = 1;  ///< for keep-last; less than 1 means 1; 0: a remote does not announce it
  bool reliable = true;
  bool transient_local = false;  ///< a writer keeps its history for late readers
  std::chrono::nanoseconds deadline = infinite;
  std::chrono::nanoseconds lifespan = infinite;
  /// How long a reliable keep-all writer waits for readers before it gives up a sample: see
  /// write(). rmw_cyclonedds has `infinite`: there one reader that never acknowledges stops its
  /// writer's thread, which here serves all topics.
  std::chrono::nanoseconds blocking_max = std::chrono::milliseconds(100);
  std::string user_data;

  bool operator==(const DdsQos&) const = default;
};

enum class WriteOutcome : std::uint8_t {
  sent,         ///< handed to the network, and kept for readers as the QoS says
  would_block,  ///< given up after blocking_max; no reader gets it
  refused,      ///< `fill` refused, or there was no memory for the sample
};

/// Checks whether Cyclone DDS accepts CYCLONEDDS_URI. Announces nothing. Returns what is wrong, in
/// one line, with Cyclone's own words; empty: nothing. One thread at a time.
[[nodiscard]] std::string fault_in_dds_configuration(std::uint32_t domain);

class DdsParticipantState;

class DdsWriter {
 public:
  ~DdsWriter();
  DdsWriter(const DdsWriter&) = delete;
  DdsWriter& operator=(const DdsWriter&) = delete;

  /// Makes a sample of at most `size` bytes, lets `fill` write it, and sends it. One allocation of
  /// that size, one pass over the bytes. Any thread.
  ///
  /// Sending itself waits at most for room in the socket's buffer. A reliable writer keeps samples
  /// that a matched reader has not acknowledged. Keep-last: it keeps the last `depth` samples,
  /// acknowledged or not, and write() never waits for a reader. Keep-all: if the unacknowledged
  /// samples exceed Cyclone's watermark (Internal/Watermarks/WhcHigh, 500 KiB, initially 30 KiB;
  /// one sample may exceed it), write() waits up to blocking_max until nearly all are acknowledged
  /// (WhcLow, 1 KiB), then gives up: would_block. Samples are kept for a reader that is gone or
  /// stopped until its lease ends (10 s in ROS 2), for one that lives and never acknowledges
  /// without end. Best-effort writers never wait.
  [[nodiscard]] DdsResult<WriteOutcome> write(std::size_t size, const RawFill& fill,
                                              std::int64_t source_time_ns);

  const Guid& guid() const noexcept { return guid_; }
  /// Returns the number of readers that it is matched with now.
  std::uint32_t matched() const;
  /// Returns the instances of the readers that it is matched with, in order: only these get a
  /// sample. A reader is in remotes() shortly before it is matched. A volatile writer sends a
  /// reader nothing of before.
  std::vector<std::uint64_t> matched_readers() const;
  /// Returns how often a reader was not matched because it requests more than the writer offers.
  std::uint32_t incompatible() const;

 private:
  friend class DdsParticipant;
  DdsWriter() = default;

  std::shared_ptr<DdsParticipantState> of_;
  std::int32_t entity_ = 0;
  const ddsi_sertype* type_ = nullptr;  // lives as long as the entity
  Guid guid_;
};

/// A sample from take().
struct DdsSample {
  enum class State : std::uint8_t {
    valid,      ///< `object` comes from the decoder
    disposed,   ///< a writer disposed of the topic's instance; `object` is null
    no_writers  ///< the last writer is gone; `object` is null
  };
  State state = State::valid;
  std::shared_ptr<void> object;
  Guid writer;  ///< unknown (is_known()) only if more than 1,024 writers went since
  std::int64_t source_time_ns = 0;  ///< since 1970, as the writer sets it, by its clock
};

class DdsReader {
 public:
  ~DdsReader();
  DdsReader(const DdsReader&) = delete;
  DdsReader& operator=(const DdsReader&) = delete;

  /// Takes the oldest sample out of the cache; nothing if there is none, or if many refused
  /// samples precede it. Refused samples are skipped.
  std::optional<DdsSample> take();

  const Guid& guid() const noexcept { return guid_; }
  /// Returns the number of writers that it is matched with now.
  std::uint32_t matched() const;
  /// Returns how often a writer was not matched because it offers less than the reader requests.
  std::uint32_t incompatible() const;
  /// Return how many payloads the decoder accepted and refused.
  std::uint64_t decoded() const noexcept { return counts_->decoded; }
  std::uint64_t refused() const noexcept { return counts_->refused; }
  /// Returns how many payloads were dropped because too much was unread.
  std::uint64_t overflow() const noexcept { return counts_->overflow; }

 private:
  friend class DdsParticipant;
  DdsReader() = default;

  std::shared_ptr<DdsParticipantState> of_;
  std::int32_t entity_ = 0;
  std::shared_ptr<RawCounts> counts_;
  Guid guid_;
};

/// A participant, reader or writer of another participant.
struct Remote {
  enum class Kind : std::uint8_t { participant, reader, writer };
  Kind kind = Kind::participant;
  Guid guid;
  Guid participant;   ///< for a participant its own GUID
  std::string topic;  ///< in DDS form; participants have only qos.user_data, the rest is empty
  std::string type;
  DdsQos qos;
  std::uint64_t instance = 0;  ///< by which this process's endpoints know it

  bool operator==(const Remote&) const = default;
};
struct RemoteChange {
  bool is_there = false;  ///< true: came or changed; false: gone, with its last state
  Remote remote;
};

class DdsParticipant {
 public:
  struct Options {
    std::uint32_t domain = 0;              ///< ROS_DOMAIN_ID
    std::string user_data = "enclave=/;";  ///< as participants of ROS 2 send
  };
  /// Starts Cyclone DDS in this process, with threads and sockets, if this is its first
  /// participant. Uses CYCLONEDDS_URI.
  [[nodiscard]] static DdsResult<std::unique_ptr<DdsParticipant>> create(const Options& options);
  ~DdsParticipant();
  DdsParticipant(const DdsParticipant&) = delete;
  DdsParticipant& operator=(const DdsParticipant&) = delete;

  /// Names are those of DDS: "rt/chatter", "std_msgs::msg::dds_::String_". A topic may have any
  /// number of endpoints, of any type. Does not wait for others.
  [[nodiscard]] DdsResult<std::unique_ptr<DdsWriter>> create_writer(const std::string& topic,
                                                                    const std::string& type,
                                                                    const DdsQos& qos);
  /// Readers do not get samples of this participant's own writers. `decoder`: see RawDecoder.
  /// Payloads beyond `unread_bytes_max` in its cache, and one message, are dropped.
  [[nodiscard]] DdsResult<std::unique_ptr<DdsReader>> create_reader(
      const std::string& topic, const std::string& type, const DdsQos& qos, RawDecoder decoder,
      std::size_t unread_bytes_max = most_of(Limit::unread_bytes_of_reader));

  struct Ready {
    bool interrupted = false;
    bool discovery = false;  ///< discovered() may have something
    std::span<DdsReader* const>
        readers;  ///< those with samples; valid until the next call or a deletion
  };
  /// Waits for an event, at most `timeout`. Samples that are not taken are ready again the next
  /// time.
  [[nodiscard]] DdsResult<Ready> wait(std::chrono::nanoseconds timeout);
  /// Makes the current wait() return, or else the next one. Any thread, but no signal handler.
  void interrupt();

  /// Returns the changes since the last call, in order for each entity, without our own entities.
  /// An entity of another participant is gone when it says so, or when its lease ends.
  std::vector<RemoteChange> discovered();
  /// Returns whether discovered() has changes that were found on the way, such as the writer of a
  /// sample that was taken.
  bool has_changes() const noexcept;
  using Remotes = std::unordered_map<Guid, Remote, GuidHash>;
  /// Returns all entities that discovered() has reported as present.
  const Remotes& remotes() const noexcept;
  /// Returns a number that differs whenever remotes() has changed.
  std::uint64_t remotes_version() const noexcept;
  /// Counts what was refused of others, here and in the caller. Any thread.
  Limits& limits() const noexcept;

  const Guid& guid() const noexcept;

 private:
  explicit DdsParticipant(std::shared_ptr<DdsParticipantState> state);

  std::shared_ptr<DdsParticipantState> state_;
};

}  // namespace agnocast::bridge
