// SPDX-License-Identifier: Apache-2.0
//
// DdsParticipant: this process in a DDS domain, as a ROS 2 context is in it: one participant,
// writers and readers of raw samples by topic and type name, and a view of what other participants
// have.
//
//   DdsParticipant ─┬─ DdsWriter   write(size, fill)            any thread
//                   ├─ DdsReader   take() what its decoder made
//                   ├─ discovered()  who came, changed, went     (DDS's built-in topics)
//                   └─ wait()      one waitset for all of these; interrupt() ends it from any thread
//
// No thread is made here. Cyclone DDS has its own: they receive, call decoders and send again what
// was lost. Everything but DdsWriter::write() and interrupt() belongs to one thread. Endpoints keep
// the participant alive, so the order of destruction is free.
//
// A name or a QoS that others announced is input: it is copied, and means nothing until somebody
// checks it. Who is beyond a limit (limits.hpp) is not followed: remotes() does not have it, and its
// samples come from a writer that is not known.
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

/// What Cyclone DDS refused.
struct DdsFailure {
  std::int32_t code = 0;  ///< one of DDS_RETCODE_…, negative
  const char* what = "";  ///< static text: the operation

  std::string text() const;  ///< "create a writer: Bad Parameter"
};
template <class T>
using DdsResult = tl::expected<T, DdsFailure>;

/// Names a participant, a reader or a writer on the network. The first 12 bytes are the
/// participant's.
struct Guid {
  std::array<std::uint8_t, 16> bytes{};

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
/// Endpoints match by the rules of DDS; blocking_max takes no part in that.
struct DdsQos {
  static constexpr std::chrono::nanoseconds infinite = std::chrono::nanoseconds::max();

  bool keep_all = false;
  std::int32_t depth =
      1;  ///< of keep-last; less than 1 is 1; of a remote that does not announce it 0
  bool reliable = true;
  bool transient_local = false;  ///< a writer keeps its history for readers that come later
  std::chrono::nanoseconds deadline = infinite;
  std::chrono::nanoseconds lifespan = infinite;
  /// How long a reliable keep-all writer waits for readers before it gives a sample up: see
  /// write(). rmw_cyclonedds has `infinite`, by which one reader that never acknowledges would stop
  /// its writer's thread, here that of all topics.
  std::chrono::nanoseconds blocking_max = std::chrono::milliseconds(100);
  std::string user_data;

  bool operator==(const DdsQos&) const = default;
};

enum class WriteOutcome : std::uint8_t {
  sent,         ///< handed to the network, and kept for readers as the QoS says
  would_block,  ///< given up after blocking_max; nobody gets it
  refused,      ///< `fill` refused, or there was no memory for the sample
};

/// Whether Cyclone DDS takes CYCLONEDDS_URI. Nothing is announced to anybody; Cyclone says what is wrong on stderr.
[[nodiscard]] DdsResult<void> check_dds_configuration(std::uint32_t domain);

class DdsParticipantState;

class DdsWriter {
 public:
  ~DdsWriter();
  DdsWriter(const DdsWriter&) = delete;
  DdsWriter& operator=(const DdsWriter&) = delete;

  /// Makes a sample of at most `size` bytes, has `fill` write it, sends it. One allocation of that
  /// size, one pass over the bytes. Any thread.
  ///
  /// Sending itself waits for room in the socket's buffer at most. A reliable writer keeps what a
  /// matched reader has not acknowledged. Keep-last: the last `depth` samples, acknowledged or not,
  /// and write() never waits for a reader. Keep-all: when what is owed is more than Cyclone's
  /// watermark (Internal/Watermarks/WhcHigh, 500 KiB, in the beginning 30 KiB; one sample may
  /// exceed it), write() waits up to blocking_max until nearly all is acknowledged (WhcLow, 1 KiB),
  /// then gives up: would_block. A reader that is gone or stopped is owed until its lease ends (10
  /// s in ROS 2); one that lives and does not acknowledge, for ever. Best-effort writers never
  /// wait.
  [[nodiscard]] DdsResult<WriteOutcome> write(std::size_t size, const RawFill& fill,
                                              std::int64_t source_time_ns);

  const Guid& guid() const noexcept { return guid_; }
  /// Readers that it is matched with now.
  std::uint32_t matched() const;
  /// How often a reader of the topic was not matched because it requests more than is offered.
  std::uint32_t incompatible() const;

 private:
  friend class DdsParticipant;
  DdsWriter() = default;

  std::shared_ptr<DdsParticipantState> of_;
  std::int32_t entity_ = 0;
  const ddsi_sertype* type_ = nullptr;  // lives as long as the entity
  Guid guid_;
};

/// What take() gives.
struct DdsSample {
  enum class State : std::uint8_t {
    valid,      ///< `object` is what the decoder made
    disposed,   ///< a writer said that the topic's instance is no more; `object` is null
    no_writers  ///< the last writer is gone; `object` is null
  };
  State state = State::valid;
  std::shared_ptr<void> object;
  Guid writer;  ///< not known (is_known()) only if more than 1,024 writers went since
  std::int64_t source_time_ns = 0;  ///< since 1970, by the writer's clock and of its choice
};

class DdsReader {
 public:
  ~DdsReader();
  DdsReader(const DdsReader&) = delete;
  DdsReader& operator=(const DdsReader&) = delete;

  /// The oldest sample, which is not in the cache any more; nothing if there is none, or if many
  /// refused ones are in front of it. These are passed over.
  std::optional<DdsSample> take();

  const Guid& guid() const noexcept { return guid_; }
  /// Writers that it is matched with now.
  std::uint32_t matched() const;
  /// How often a writer of the topic was not matched because it offers less than is requested.
  std::uint32_t incompatible() const;
  /// Payloads that the decoder made something of, and that it refused.
  std::uint64_t decoded() const noexcept { return counts_->decoded; }
  std::uint64_t refused() const noexcept { return counts_->refused; }
  /// Payloads that were dropped since too much was unread.
  std::uint64_t overflow() const noexcept { return counts_->overflow; }

 private:
  friend class DdsParticipant;
  DdsReader() = default;

  std::shared_ptr<DdsParticipantState> of_;
  std::int32_t entity_ = 0;
  std::shared_ptr<RawCounts> counts_;
  Guid guid_;
};

/// A participant, reader or writer that another participant has.
struct Remote {
  enum class Kind : std::uint8_t { participant, reader, writer };
  Kind kind = Kind::participant;
  Guid guid;
  Guid participant;  ///< of a participant its own
  std::string
      topic;  ///< as DDS has it; empty for participants, as is what follows but qos.user_data
  std::string type;
  DdsQos qos;

  bool operator==(const Remote&) const = default;
};
struct RemoteChange {
  bool is_there = false;  ///< came, or changed; else went, and `remote` is as it was
  Remote remote;
};

class DdsParticipant {
 public:
  struct Options {
    std::uint32_t domain = 0;              ///< ROS_DOMAIN_ID
    std::string user_data = "enclave=/;";  ///< what participants of ROS 2 say
  };
  /// Starts Cyclone DDS in this process if this is its first participant, with threads and sockets,
  /// as CYCLONEDDS_URI says.
  [[nodiscard]] static DdsResult<std::unique_ptr<DdsParticipant>> create(const Options& options);
  ~DdsParticipant();
  DdsParticipant(const DdsParticipant&) = delete;
  DdsParticipant& operator=(const DdsParticipant&) = delete;

  /// Names are DDS's: "rt/chatter", "std_msgs::msg::dds_::String_". A topic has as many endpoints
  /// as are made, of any type. Does not wait for others.
  [[nodiscard]] DdsResult<std::unique_ptr<DdsWriter>> create_writer(const std::string& topic,
                                                                    const std::string& type,
                                                                    const DdsQos& qos);
  /// Readers do not get what writers of this participant write. `decoder`: see RawDecoder. Beyond `unread_bytes_max`
  /// in its cache, and one message, a payload is dropped.
  [[nodiscard]] DdsResult<std::unique_ptr<DdsReader>> create_reader(const std::string& topic,
                                                                    const std::string& type,
                                                                    const DdsQos& qos,
                                                                    RawDecoder decoder,
                                                                    std::size_t unread_bytes_max =
                                                                        most_of(Limit::unread_bytes_of_reader));

  struct Ready {
    bool interrupted = false;
    bool discovery = false;  ///< discovered() may have something
    std::span<DdsReader* const>
        readers;  ///< have samples; until the next call, or one of them is deleted
  };
  /// Waits until there is something, at most `timeout`. What is not taken is ready again the next
  /// time.
  [[nodiscard]] DdsResult<Ready> wait(std::chrono::nanoseconds timeout);
  /// The wait of now, or else the next one, returns. Any thread, but no signal handler.
  void interrupt();

  /// What changed since the last call, in order for each entity. Own ones are left out. What
  /// another participant had goes when it says so, or when its lease ends.
  std::vector<RemoteChange> discovered();
  using Remotes = std::unordered_map<Guid, Remote, GuidHash>;
  /// Everything that discovered() said is there.
  const Remotes& remotes() const noexcept;
  /// Another number whenever remotes() has changed.
  std::uint64_t remotes_version() const noexcept;
  /// What was refused of others, here and by whoever uses this. Any thread.
  Limits& limits() const noexcept;

  const Guid& guid() const noexcept;

 private:
  explicit DdsParticipant(std::shared_ptr<DdsParticipantState> state);

  std::shared_ptr<DdsParticipantState> state_;
};

}  // namespace agnocast::bridge
