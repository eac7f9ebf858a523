// SPDX-License-Identifier: Apache-2.0

#include <bridge/dds/participant.hpp>

#include <dds/dds.h>
#include <dds/ddsi/ddsi_serdata.h>
#include <dds/ddsi/ddsi_sertype.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <deque>
#include <mutex>
#include <string_view>
#include <utility>

namespace agnocast::bridge {
namespace {

using std::chrono::nanoseconds;
static_assert(DdsQos::infinite.count() == DDS_INFINITY && sizeof(Guid) == sizeof(dds_guid_t));

tl::unexpected<DdsFailure> refused(std::int32_t code, const char* what) {
  return tl::unexpected<DdsFailure>(DdsFailure{code, what});
}

using OwnedQos = std::unique_ptr<dds_qos_t, decltype(&dds_delete_qos)>;
OwnedQos no_qos() { return {dds_create_qos(), &dds_delete_qos}; }

OwnedQos qos_of(const DdsQos& from) {
  OwnedQos qos = no_qos();
  const auto history = from.keep_all ? DDS_HISTORY_KEEP_ALL : DDS_HISTORY_KEEP_LAST;
  const std::int32_t depth = std::max(from.depth, 1);
  dds_qset_history(qos.get(), history, depth);
  dds_qset_reliability(qos.get(),
                       from.reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT,
                       std::max(from.blocking_max, nanoseconds(0)).count());
  dds_qset_durability(
      qos.get(), from.transient_local ? DDS_DURABILITY_TRANSIENT_LOCAL : DDS_DURABILITY_VOLATILE);
  if (from.transient_local) {
    dds_qset_durability_service(qos.get(), 0, history, depth, DDS_LENGTH_UNLIMITED,
                                DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED);
  }
  dds_qset_deadline(qos.get(), from.deadline.count());
  dds_qset_lifespan(qos.get(), from.lifespan.count());
  dds_qset_liveliness(qos.get(), DDS_LIVELINESS_AUTOMATIC, DDS_INFINITY);
  dds_qset_writer_data_lifecycle(qos.get(), false);
  dds_qset_ignorelocal(qos.get(), DDS_IGNORELOCAL_PARTICIPANT);
  dds_qset_userdata(qos.get(), from.user_data.data(), from.user_data.size());
  return qos;
}

std::string user_data_of(const dds_qos_t* qos) {
  void* bytes = nullptr;
  std::size_t size = 0;
  if (!dds_qget_userdata(qos, &bytes, &size) || bytes == nullptr) return {};
  const std::unique_ptr<void, decltype(&dds_free)> owned(bytes, &dds_free);
  return {static_cast<const char*>(bytes), size};
}

/// Only Cyclone DDS announces histories; for others it reports its own default. The first two
/// bytes of a GUID are the vendor (RTPS 2.3, 9.3.1.5).
bool announces_history(const Guid& guid) { return guid.bytes[0] == 0x01 && guid.bytes[1] == 0x10; }

DdsQos qos_from(const dds_qos_t* from, const Guid& guid) {
  DdsQos qos;
  dds_history_kind_t history{};
  dds_reliability_kind_t reliability{};
  dds_durability_kind_t durability{};
  dds_duration_t duration = 0;
  if (!announces_history(guid)) {
    qos.depth = 0;
  } else if (dds_qget_history(from, &history, &qos.depth)) {
    qos.keep_all = history == DDS_HISTORY_KEEP_ALL;
  }
  if (dds_qget_reliability(from, &reliability, &duration)) {
    qos.reliable = reliability == DDS_RELIABILITY_RELIABLE;
    qos.blocking_max = nanoseconds(duration);
  }
  if (dds_qget_durability(from, &durability))
    qos.transient_local = durability != DDS_DURABILITY_VOLATILE;
  if (dds_qget_deadline(from, &duration)) qos.deadline = nanoseconds(duration);
  if (dds_qget_lifespan(from, &duration)) qos.lifespan = nanoseconds(duration);
  qos.user_data = user_data_of(from);
  return qos;
}

Guid guid_from(const dds_guid_t& from) {
  Guid guid;
  std::copy(std::begin(from.v), std::end(from.v), guid.bytes.begin());
  return guid;
}

DdsResult<Guid> guid_of(dds_entity_t entity) {
  dds_guid_t guid;
  if (const dds_return_t code = dds_get_guid(entity, &guid); code < 0)
    return refused(code, "ask for a GUID");
  return guid_from(guid);
}

struct BuiltinTopic {
  Remote::Kind kind;
  dds_entity_t topic;
};
// Participants last: Cyclone announces a participant before its endpoints, so the owner of every
// taken endpoint is known as well.
const BuiltinTopic builtin_topics[] = {
    {Remote::Kind::writer, DDS_BUILTIN_TOPIC_DCPSPUBLICATION},
    {Remote::Kind::reader, DDS_BUILTIN_TOPIC_DCPSSUBSCRIPTION},
    {Remote::Kind::participant, DDS_BUILTIN_TOPIC_DCPSPARTICIPANT},
};

// Values that the waitset returns for attached conditions; for readers it is their address.
constexpr dds_attach_t attached_guard = 0;
constexpr dds_attach_t attached_discovery = 1;

// Samples of a writer may be taken after it is gone.
constexpr std::size_t gone_writers_max = 1024;
// Bound for one take from a built-in topic, since others keep changing theirs; the rest stays
// ready.
constexpr std::size_t changes_max = 1'000;
// Refused samples that one take() skips: others may write them faster than they are taken.
constexpr std::size_t passed_over_max = 1'000;

}  // namespace

class DdsParticipantState {
 public:
  DdsParticipantState() = default;
  DdsParticipantState(const DdsParticipantState&) = delete;
  DdsParticipantState& operator=(const DdsParticipantState&) = delete;
  ~DdsParticipantState() {
    if (participant > 0) dds_delete(participant);  // and all its entities
  }

  /// Takes the samples of the built-in topics.
  void pump() {
    for (std::size_t i = 0; i < std::size(builtin_topics); ++i) {
      for (std::size_t taken = 0; taken < changes_max; ++taken) {
        void* sample = nullptr;
        dds_sample_info_t info;
        if (dds_take(builtin[i], &sample, &info, 1, 1) <= 0) break;
        note(builtin_topics[i].kind, sample, info);
        dds_return_loan(builtin[i], &sample, 1);
      }
    }
  }

  /// Returns the writer that a sample names by its handle.
  Guid writer_of(dds_instance_handle_t handle) {
    auto at = writers.find(handle);
    if (at == writers.end()) {
      pump();
      at = writers.find(handle);
    }
    return at == writers.end() ? Guid{} : at->second;
  }

  dds_entity_t participant = 0;
  dds_entity_t waitset = 0;
  dds_entity_t guard = 0;
  dds_entity_t builtin[std::size(builtin_topics)] = {};
  Guid guid;
  std::vector<DdsReader*> readers;
  std::vector<dds_attach_t> triggered;
  std::vector<DdsReader*> ready;
  DdsParticipant::Remotes remotes;
  std::uint64_t remotes_version = 0;
  std::vector<RemoteChange> changes;
  const std::shared_ptr<RawShared> shared = std::make_shared<RawShared>();

 private:
  bool is_too_long(const Remote& remote) {
    constexpr std::size_t most = most_of(Limit::text_bytes);
    return remote.topic.size() > most || remote.type.size() > most ||
           remote.qos.user_data.size() > most;
  }
  /// Returns whether there is room for one more; counts refusals.
  bool has_place(const Remote& remote) {
    const auto beyond = [&](Limit limit) {
      shared->limits.refuse(limit);
      return false;
    };
    if (is_too_long(remote)) return beyond(Limit::text_bytes);
    if (remote.kind == Remote::Kind::participant)
      return participants < most_of(Limit::participants) || beyond(Limit::participants);
    if (remotes.size() - participants >= most_of(Limit::endpoints)) return beyond(Limit::endpoints);
    const auto of_owner = endpoints.find(remote.participant);
    return of_owner == endpoints.end() ||
           of_owner->second < most_of(Limit::endpoints_of_participant) ||
           beyond(Limit::endpoints_of_participant);
  }
  void count(const Remote& remote, bool is_there) {
    ++remotes_version;
    if (remote.kind == Remote::Kind::participant) {
      is_there ? ++participants : --participants;
    } else if (is_there) {
      ++endpoints[remote.participant];
    } else if (const auto of_owner = endpoints.find(remote.participant);
               of_owner != endpoints.end() && --of_owner->second == 0) {
      endpoints.erase(of_owner);
    }
  }
  void note(Remote::Kind kind, const void* sample, const dds_sample_info_t& info) {
    Remote remote;
    remote.kind = kind;
    remote.instance = info.instance_handle;
    const dds_qos_t* qos = nullptr;
    if (kind == Remote::Kind::participant) {
      const auto& of = *static_cast<const dds_builtintopic_participant_t*>(sample);
      remote.guid = remote.participant = guid_from(of.key);
      qos = of.qos;
    } else {
      const auto& of = *static_cast<const dds_builtintopic_endpoint_t*>(sample);
      remote.guid = guid_from(of.key);
      remote.participant = guid_from(of.participant_key);
      if (info.valid_data) {
        remote.topic = of.topic_name;
        remote.type = of.type_name;
      }
      qos = of.qos;
    }
    if (info.valid_data) {
      if (kind == Remote::Kind::participant)
        remote.qos.user_data = user_data_of(qos);
      else
        remote.qos = qos_from(qos, remote.guid);
    }
    // Skip our own entities, and those of built-in topics, visible only within a process.
    if (remote.guid.is_of_participant(guid) || remote.topic.starts_with("DCPS")) return;
    if (info.instance_state != DDS_IST_ALIVE) {
      if (kind == Remote::Kind::writer) forget_later(info.instance_handle, remote.guid);
      const auto at = remotes.find(remote.guid);
      if (at == remotes.end()) {
        // It came and went since the last call; the notice that it is gone carries its data.
        if (!info.valid_data || !has_place(remote)) return;
        changes.push_back({true, remote});
        changes.push_back({false, std::move(remote)});
        return;
      }
      count(at->second, false);
      changes.push_back({false, std::move(at->second)});
      remotes.erase(at);
      return;
    }
    if (!info.valid_data) return;
    const auto at = remotes.find(remote.guid);
    if (at != remotes.end() && (at->second == remote || is_too_long(remote))) return;
    if (at == remotes.end()) {
      if (!has_place(remote)) return;
      count(remote, true);
    } else {
      ++remotes_version;
    }
    if (kind == Remote::Kind::writer) writers[info.instance_handle] = remote.guid;
    remotes[remote.guid] = remote;
    changes.push_back({true, std::move(remote)});
  }

  void forget_later(dds_instance_handle_t handle, const Guid& writer) {
    writers[handle] = writer;
    if (!gone.empty() && gone.back() == handle) return;
    gone.push_back(handle);
    if (gone.size() <= gone_writers_max) return;
    writers.erase(gone.front());
    gone.pop_front();
  }

  std::unordered_map<dds_instance_handle_t, Guid> writers;
  std::deque<dds_instance_handle_t> gone;
  std::size_t participants = 0;                               // in remotes
  std::unordered_map<Guid, std::size_t, GuidHash> endpoints;  // in remotes, by participant
};

namespace {

/// Attaches a condition that holds as long as the reader has samples, so that taking only some
/// loses none.
dds_return_t attach(const DdsParticipantState& state, dds_entity_t reader, dds_attach_t what) {
  const dds_entity_t condition = dds_create_readcondition(reader, DDS_ANY_STATE);
  return condition < 0 ? condition : dds_waitset_attach(state.waitset, condition, what);
}

struct Endpoint {
  dds_entity_t entity;
  const ddsi_sertype* type;
};

/// Deletes the topic again at once: its endpoint keeps what it needs.
template <class Create>
DdsResult<Endpoint> make_endpoint(const DdsParticipantState& state, const std::string& topic,
                                  ddsi_sertype* type, const char* what, const Create& create) {
  const dds_entity_t of =
      dds_create_topic_sertype(state.participant, topic.c_str(), &type, nullptr, nullptr, nullptr);
  if (of < 0) {
    ddsi_sertype_unref(type);
    return refused(of, "create a topic");
  }
  const dds_entity_t entity = create(of);
  dds_delete(of);
  if (entity < 0) return refused(entity, what);
  return Endpoint{entity, type};
}

}  // namespace

std::string DdsFailure::text() const { return std::string(what) + ": " + dds_strretcode(code); }

std::string fault_in_dds_configuration(std::uint32_t domain) {
  const char* const uri = std::getenv("CYCLONEDDS_URI");
  if (uri == nullptr || *uri == '\0') return {};
  struct Said {
    std::mutex mutex;  // Cyclone's own threads may speak as well
    std::string text;
  } said;
  dds_set_log_sink(
      [](void* to, const dds_log_data_t* data) {
        std::string line(data->message, data->size);
        while (!line.empty() && (line.back() == '\n' || line.back() == '\0')) line.pop_back();
        // Cyclone ends the process after a fatal one.
        if ((data->priority & DDS_LC_ERROR) == 0)
          return static_cast<void>(std::fprintf(stderr, "%s\n", line.c_str()));
        std::replace(line.begin(), line.end(), '\n', ' ');
        auto& all = *static_cast<Said*>(to);
        const std::lock_guard lock(all.mutex);
        all.text.append(": ").append(line);
      },
      &said);
  const auto fault_with = [&](const std::string& more) -> std::string {
    said.text.clear();
    const std::string all =
        std::string(uri) + ",<CycloneDDS><Domain>" + more + "</Domain></CycloneDDS>";
    const dds_entity_t made = dds_create_domain(domain, all.c_str());
    if (made >= 0) dds_delete(made);
    return made >= 0 ? "" : DdsFailure{made, "CYCLONEDDS_URI"}.text() + said.text;
  };
  // Without multicast each process of a domain has an index, and Cyclone DDS has few: that all are
  // in use is no fault of the configuration. Later parts of the list override earlier ones.
  const std::string without_index =
      "<Discovery><ParticipantIndex>none</ParticipantIndex></Discovery>";
  std::string fault = fault_with(without_index);
  // Where multicast is wanted and an interface has none, Cyclone DDS takes an index all the same.
  if (fault.find("participant index") != std::string::npos)
    fault = fault_with("<General><AllowMulticast>false</AllowMulticast></General>" + without_index);
  dds_set_log_sink(nullptr, nullptr);
  return fault;
}

std::size_t GuidHash::operator()(const Guid& guid) const noexcept {
  return std::hash<std::string_view>()(
      {reinterpret_cast<const char*>(guid.bytes.data()), guid.bytes.size()});
}

DdsWriter::~DdsWriter() {
  if (entity_ > 0) dds_delete(entity_);
}

DdsResult<WriteOutcome> DdsWriter::write(std::size_t size, const RawFill& fill,
                                         std::int64_t source_time_ns) {
  ddsi_serdata* const sample = make_raw_sample(*type_, size, fill, source_time_ns);
  if (sample == nullptr) return WriteOutcome::refused;
  const dds_return_t code = dds_forwardcdr(entity_, sample);  // takes the reference
  if (code == DDS_RETCODE_TIMEOUT) return WriteOutcome::would_block;
  if (code < 0) return bridge::refused(code, "write");
  return WriteOutcome::sent;
}

std::vector<std::uint64_t> DdsWriter::matched_readers() const {
  std::vector<dds_instance_handle_t> readers(matched());
  const dds_return_t count = dds_get_matched_subscriptions(entity_, readers.data(), readers.size());
  // Others may have come or gone since.
  readers.resize(std::min(readers.size(), static_cast<std::size_t>(std::max(count, 0))));
  std::sort(readers.begin(), readers.end());
  return readers;
}
std::uint32_t DdsWriter::matched() const {
  dds_publication_matched_status_t status{};
  return dds_get_publication_matched_status(entity_, &status) < 0 ? 0 : status.current_count;
}

std::uint32_t DdsWriter::incompatible() const {
  dds_offered_incompatible_qos_status_t status{};
  return dds_get_offered_incompatible_qos_status(entity_, &status) < 0 ? 0 : status.total_count;
}

DdsReader::~DdsReader() {
  if (of_ != nullptr) std::erase(of_->readers, this);
  if (entity_ > 0) dds_delete(entity_);
}

std::optional<DdsSample> DdsReader::take() {
  for (std::size_t passed_over = 0; passed_over <= passed_over_max; ++passed_over) {
    ddsi_serdata* taken = nullptr;
    dds_sample_info_t info;
    if (dds_takecdr(entity_, &taken, 1, &info, DDS_ANY_STATE) <= 0) return std::nullopt;
    const std::unique_ptr<ddsi_serdata, decltype(&ddsi_serdata_unref)> owned(taken,
                                                                             &ddsi_serdata_unref);
    DdsSample sample;
    if (info.valid_data) {
      sample.object = object_of(*taken);
      if (sample.object == nullptr) continue;
    } else {
      sample.state = info.instance_state == DDS_IST_NOT_ALIVE_DISPOSED
                         ? DdsSample::State::disposed
                         : DdsSample::State::no_writers;
    }
    sample.writer = of_->writer_of(info.publication_handle);
    sample.source_time_ns = info.source_timestamp;
    return sample;
  }
  return std::nullopt;
}

std::uint32_t DdsReader::matched() const {
  dds_subscription_matched_status_t status{};
  return dds_get_subscription_matched_status(entity_, &status) < 0 ? 0 : status.current_count;
}

std::uint32_t DdsReader::incompatible() const {
  dds_requested_incompatible_qos_status_t status{};
  return dds_get_requested_incompatible_qos_status(entity_, &status) < 0 ? 0 : status.total_count;
}

DdsResult<std::unique_ptr<DdsParticipant>> DdsParticipant::create(const Options& options) {
  auto state = std::make_shared<DdsParticipantState>();
  const OwnedQos qos = no_qos();
  dds_qset_userdata(qos.get(), options.user_data.data(), options.user_data.size());
  state->participant = dds_create_participant(options.domain, qos.get(), nullptr);
  if (state->participant < 0) return refused(state->participant, "create a participant");
  const auto guid = guid_of(state->participant);
  if (!guid) return tl::unexpected(guid.error());
  state->guid = *guid;
  state->waitset = dds_create_waitset(state->participant);
  if (state->waitset < 0) return refused(state->waitset, "create a waitset");
  state->guard = dds_create_guardcondition(state->participant);
  if (state->guard < 0) return refused(state->guard, "create a guard condition");
  if (const auto code = dds_waitset_attach(state->waitset, state->guard, attached_guard); code < 0)
    return refused(code, "attach the guard condition");
  for (std::size_t i = 0; i < std::size(builtin_topics); ++i) {
    state->builtin[i] =
        dds_create_reader(state->participant, builtin_topics[i].topic, nullptr, nullptr);
    if (state->builtin[i] < 0) return refused(state->builtin[i], "read a built-in topic");
    if (const auto code = attach(*state, state->builtin[i], attached_discovery); code < 0)
      return refused(code, "attach a built-in topic");
  }
  return std::unique_ptr<DdsParticipant>(new DdsParticipant(std::move(state)));
}

DdsParticipant::DdsParticipant(std::shared_ptr<DdsParticipantState> state)
    : state_(std::move(state)) {}
DdsParticipant::~DdsParticipant() = default;

DdsResult<std::unique_ptr<DdsWriter>> DdsParticipant::create_writer(const std::string& topic,
                                                                    const std::string& type,
                                                                    const DdsQos& qos) {
  std::unique_ptr<DdsWriter> writer(new DdsWriter);
  const auto endpoint = make_endpoint(
      *state_, topic, make_raw_type(type, nullptr, std::make_shared<RawCounts>(state_->shared)),
      "create a writer", [&](dds_entity_t of) {
        return dds_create_writer(state_->participant, of, qos_of(qos).get(), nullptr);
      });
  if (!endpoint) return tl::unexpected(endpoint.error());
  writer->of_ = state_;
  writer->entity_ = endpoint->entity;
  writer->type_ = endpoint->type;
  const auto guid = guid_of(writer->entity_);
  if (!guid) return tl::unexpected(guid.error());
  writer->guid_ = *guid;
  return writer;
}

DdsResult<std::unique_ptr<DdsReader>> DdsParticipant::create_reader(const std::string& topic,
                                                                    const std::string& type,
                                                                    const DdsQos& qos,
                                                                    RawDecoder decoder,
                                                                    std::size_t unread_bytes_max) {
  std::unique_ptr<DdsReader> reader(new DdsReader);
  reader->counts_ = std::make_shared<RawCounts>(state_->shared, unread_bytes_max);
  const auto endpoint =
      make_endpoint(*state_, topic, make_raw_type(type, std::move(decoder), reader->counts_),
                    "create a reader", [&](dds_entity_t of) {
                      return dds_create_reader(state_->participant, of, qos_of(qos).get(), nullptr);
                    });
  if (!endpoint) return tl::unexpected(endpoint.error());
  reader->entity_ = endpoint->entity;
  const auto guid = guid_of(reader->entity_);
  if (!guid) return tl::unexpected(guid.error());
  reader->guid_ = *guid;
  reader->of_ = state_;
  state_->readers.push_back(reader.get());
  const auto what = reinterpret_cast<dds_attach_t>(reader.get());
  if (const auto code = attach(*state_, reader->entity_, what); code < 0)
    return refused(code, "attach a reader");
  return reader;
}

DdsResult<DdsParticipant::Ready> DdsParticipant::wait(std::chrono::nanoseconds timeout) {
  DdsParticipantState& state = *state_;
  const std::size_t attached = state.readers.size() + 1 + std::size(builtin_topics);
  if (state.triggered.size() < attached) state.triggered.resize(attached);
  // A lookup of a sample's writer may have found changes on the way.
  if (timeout < nanoseconds(0) || !state.changes.empty()) timeout = nanoseconds(0);
  const dds_return_t count = dds_waitset_wait(state.waitset, state.triggered.data(),
                                              state.triggered.size(), timeout.count());
  if (count < 0) return refused(count, "wait");
  Ready ready;
  state.ready.clear();
  const std::span triggered(state.triggered);
  for (const dds_attach_t what :
       triggered.first(std::min(triggered.size(), static_cast<std::size_t>(count)))) {
    if (what == attached_guard) {
      bool was_set = false;
      dds_take_guardcondition(state.guard, &was_set);
      ready.interrupted = true;
    } else if (what == attached_discovery) {
      ready.discovery = true;
    } else {
      state.ready.push_back(reinterpret_cast<DdsReader*>(what));
    }
  }
  ready.discovery = ready.discovery || !state.changes.empty();
  ready.readers = state.ready;
  return ready;
}

void DdsParticipant::interrupt() { dds_set_guardcondition(state_->guard, true); }

std::vector<RemoteChange> DdsParticipant::discovered() {
  state_->pump();
  return std::exchange(state_->changes, {});
}

bool DdsParticipant::has_changes() const noexcept { return !state_->changes.empty(); }

const DdsParticipant::Remotes& DdsParticipant::remotes() const noexcept { return state_->remotes; }
std::uint64_t DdsParticipant::remotes_version() const noexcept { return state_->remotes_version; }
Limits& DdsParticipant::limits() const noexcept { return state_->shared->limits; }
const Guid& DdsParticipant::guid() const noexcept { return state_->guid; }

}  // namespace agnocast::bridge
