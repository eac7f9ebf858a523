// SPDX-License-Identifier: Apache-2.0
//
// A program of Fast DDS without any of our code that does the same as rmw_fastrtps_cpp for topics
// of one node, with ROS_LOCALHOST_ONLY=1: UDP on the loopback device, and the vendor's shared
// memory beside it. Its types are written with Fast CDR. Steered line by line:
//   fast_peer DOMAIN [no-shm]        its node is /fast_peer. no-shm: for one to be killed
//     writer NAME TOPIC TYPE QOS…    TYPE: String, Bool, Cloud, Markers
//                                    QOS: best or reliable, transient, all or a depth
//     reader NAME TOPIC TYPE QOS…
//     matched NAME                   how many
//     write NAME NUMBER              the message of that number (values.hpp)
//     letters NAME NUMBER COUNT      a String of that many letters
//     take NAME                      the next message, as text; "none" without one
//     others TOPIC                   endpoints that other participants announce: a sorted list
//     nodes                          of others, by ros_discovery_info: sorted "NODE TOPIC …"
//     delete NAME

#include <tests/integration/bridge/programs/values.hpp>

#include <rmw_dds_common/msg/participant_entities_info.hpp>
#include <sensor_msgs/msg/point_cloud2.hpp>
#include <std_msgs/msg/bool.hpp>
#include <std_msgs/msg/string.hpp>
#include <visualization_msgs/msg/marker_array.hpp>

#include <fastcdr/Cdr.h>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastdds/rtps/transport/shared_mem/SharedMemTransportDescriptor.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include <algorithm>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <set>

namespace {

using namespace agnocast::test;
using namespace eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;
using eprosima::fastrtps::types::ReturnCode_t;
using rmw_dds_common::msg::ParticipantEntitiesInfo;

/// Members to CDR and from it, in the order in which a See names them.
class Write {
 public:
  explicit Write(Cdr& cdr) : cdr_(cdr) {}
  template <class Value>
  void operator()(const Value& value) {
    cdr_ << value;
  }
  template <class Sequence>
  void bytes(const Sequence& sequence) {
    cdr_ << sequence;
  }
  template <class Sequence>
  void scan(const Sequence& sequence) {
    cdr_ << sequence;
  }
  template <class Sequence, class See>
  void each(const Sequence& sequence, See see) {
    cdr_ << static_cast<std::uint32_t>(sequence.size());
    for (const auto& element : sequence) see(*this, element);
  }

 private:
  Cdr& cdr_;
};
class Read {
 public:
  explicit Read(Cdr& cdr) : cdr_(cdr) {}
  template <class Value>
  void operator()(Value& value) {
    cdr_ >> value;
  }
  template <class Sequence>
  void bytes(Sequence& sequence) {
    cdr_ >> sequence;
  }
  template <class Sequence>
  void scan(Sequence& sequence) {
    cdr_ >> sequence;
  }
  template <class Sequence, class See>
  void each(Sequence& sequence, See see) {
    std::uint32_t count = 0;
    cdr_ >> count;
    sequence.resize(count);
    for (auto& element : sequence) see(*this, element);
  }

 private:
  Cdr& cdr_;
};

struct SeeEntities {
  template <class See, class M>
  void operator()(See& see, M& info) const {
    const auto see_gid = [](auto& own, auto& gid) { own(gid.data); };
    see_gid(see, info.gid);
    see.each(info.node_entities_info_seq, [&](auto& own, auto& node) {
      own(node.node_namespace), own(node.node_name);
      own.each(node.reader_gid_seq, see_gid), own.each(node.writer_gid_seq, see_gid);
    });
  }
};

template <class M, class See>
class TypeOf : public TopicDataType {
 public:
  /// `fixed_bytes`: the size of the body, if it is the same for all messages.
  TypeOf(const char* name, std::uint32_t fixed_bytes) {
    setName(name);
    m_isGetKeyDefined = false;
    m_typeSize = (4 + fixed_bytes + 3) / 4 * 4;
    auto_fill_type_object(false);
    auto_fill_type_information(false);
  }
  bool serialize(void* data, rtps::SerializedPayload_t* payload) override {
    FastBuffer room(reinterpret_cast<char*>(payload->data), payload->max_size);
    payload->length = write(*static_cast<const M*>(data), room);
    payload->encapsulation = CDR_LE;
    return true;
  }
  bool deserialize(rtps::SerializedPayload_t* payload, void* data) override {
    FastBuffer bytes(reinterpret_cast<char*>(payload->data), payload->length);
    Cdr cdr(bytes, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
    try {
      cdr.read_encapsulation();
      Read see(cdr);
      See()(see, *static_cast<M*>(data));
    } catch (const eprosima::fastcdr::exception::Exception& error) {
      std::cerr << getName() << ": " << error.what() << std::endl;
      return false;
    }
    return true;
  }
  std::function<std::uint32_t()> getSerializedSizeProvider(void* data) override {
    return [data] {
      FastBuffer room;
      return write(*static_cast<const M*>(data), room);
    };
  }
  void* createData() override { return new M; }
  void deleteData(void* data) override { delete static_cast<M*>(data); }
  bool getKey(void*, rtps::InstanceHandle_t*, bool) override { return false; }

 private:
  static std::uint32_t write(const M& message, FastBuffer& room) {
    Cdr cdr(room, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
    cdr.serialize_encapsulation();
    Write see(cdr);
    See()(see, message);
    return static_cast<std::uint32_t>(cdr.getSerializedDataLength());
  }
};

struct Type {
  TypeSupport support;
  bool is_fixed;
  std::function<bool(DataWriter&, std::uint64_t)> write;
  std::function<std::string(DataReader&)> take;
};

template <class M, class See>
Type type_of(const char* name, std::uint32_t fixed_bytes = 0) {
  return {TypeSupport(new TypeOf<M, See>(name, fixed_bytes)), fixed_bytes > 0,
          [](DataWriter& writer, std::uint64_t number) {
            M message;
            set_values<See>(number, message);
            return writer.write(&message);
          },
          [](DataReader& reader) -> std::string {
            M message;
            SampleInfo info;
            while (reader.take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK)
              if (info.valid_data) return text_of<See>(message);
            return "none";
          }};
}

const std::map<std::string, Type>& types() {
  static const std::map<std::string, Type> all = {
      {"String", type_of<std_msgs::msg::String, SeeString>("std_msgs::msg::dds_::String_")},
      {"Bool", type_of<std_msgs::msg::Bool, SeeString>("std_msgs::msg::dds_::Bool_", 1)},
      {"Cloud",
       type_of<sensor_msgs::msg::PointCloud2, SeeCloud>("sensor_msgs::msg::dds_::PointCloud2_")},
      {"Markers", type_of<visualization_msgs::msg::MarkerArray, SeeMarkers>(
                      "visualization_msgs::msg::dds_::MarkerArray_")},
      {"Entities",
       {TypeSupport(new TypeOf<ParticipantEntitiesInfo, SeeEntities>(
            "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_", 0)),
        false, nullptr, nullptr}}};
  return all;
}

using Gid = decltype(rmw_dds_common::msg::Gid::data);

/// Returns 16 bytes of DDS and 8 zeros.
Gid gid_of(const rtps::GUID_t& guid) {
  Gid gid{};
  const auto after =
      std::copy(std::begin(guid.guidPrefix.value), std::end(guid.guidPrefix.value), gid.begin());
  std::copy(std::begin(guid.entityId.value), std::end(guid.entityId.value), after);
  return gid;
}

/// Endpoints that others announce. Fast DDS reports them in threads of its own.
class Others : public DomainParticipantListener {
 public:
  void on_participant_discovery(DomainParticipant*,
                                rtps::ParticipantDiscoveryInfo&& news) override {
    const std::lock_guard lock(mutex_);
    const Gid gid = gid_of(news.info.m_guid);
    if (news.status == rtps::ParticipantDiscoveryInfo::REMOVED_PARTICIPANT ||
        news.status == rtps::ParticipantDiscoveryInfo::DROPPED_PARTICIPANT)
      participants_.erase(gid);
    else
      participants_.insert(gid);
  }
  // It reports own endpoints as well.
  void on_subscriber_discovery(DomainParticipant* own, rtps::ReaderDiscoveryInfo&& news) override {
    if (news.info.guid().guidPrefix == own->guid().guidPrefix) return;
    note("reader ", news.info, news.status == rtps::ReaderDiscoveryInfo::REMOVED_READER);
  }
  void on_publisher_discovery(DomainParticipant* own, rtps::WriterDiscoveryInfo&& news) override {
    if (news.info.guid().guidPrefix == own->guid().guidPrefix) return;
    note("writer ", news.info, news.status == rtps::WriterDiscoveryInfo::REMOVED_WRITER);
  }

  bool is_there(const Gid& participant) const {
    const std::lock_guard lock(mutex_);
    return participants_.contains(participant);
  }
  std::string topic_of(const Gid& endpoint) const {
    const std::lock_guard lock(mutex_);
    const auto found = endpoints_.find(endpoint);
    return found == endpoints_.end() ? "?" : found->second.topic;
  }
  std::vector<std::string> of_topic(const std::string& topic) const {
    const std::lock_guard lock(mutex_);
    std::vector<std::string> list;
    for (const auto& [gid, endpoint] : endpoints_)
      if (endpoint.topic == topic) list.push_back(endpoint.words);
    return list;
  }

 private:
  struct Endpoint {
    std::string topic, words;
  };
  template <class Info>
  void note(const char* what, const Info& info, bool is_gone) {
    const std::lock_guard lock(mutex_);
    const Gid gid = gid_of(info.guid());
    if (is_gone) {
      endpoints_.erase(gid);
      return;
    }
    std::string words = what + info.typeName().to_string();
    words += info.m_qos.m_reliability.kind == RELIABLE_RELIABILITY_QOS ? " reliable" : " best";
    if (info.m_qos.m_durability.kind == TRANSIENT_LOCAL_DURABILITY_QOS) words += " transient";
    endpoints_[gid] = {info.topicName().to_string(), words};
  }

  mutable std::mutex mutex_;
  std::set<Gid> participants_;
  std::map<Gid, Endpoint> endpoints_;
};

std::string joined(std::vector<std::string> list) {
  std::sort(list.begin(), list.end());
  std::string text;
  for (const std::string& one : list) text += (text.empty() ? "" : ", ") + one;
  return text;
}

struct Endpoint {
  DataWriter* writer = nullptr;
  DataReader* reader = nullptr;
  const Type* type = nullptr;
};

class Peer {
 public:
  Peer(DomainId_t domain, bool has_shm) {
    DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
    const std::string enclave = "enclave=/;";
    qos.name("/");
    qos.user_data().data_vec({enclave.begin(), enclave.end()});
    qos.wire_protocol().builtin.readerHistoryMemoryPolicy =
        qos.wire_protocol().builtin.writerHistoryMemoryPolicy =
            rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    qos.transport().use_builtin_transports = false;
    const auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    udp->interfaceWhiteList.emplace_back("127.0.0.1");
    qos.transport().user_transports.push_back(udp);
    if (has_shm)
      qos.transport().user_transports.push_back(
          std::make_shared<eprosima::fastdds::rtps::SharedMemTransportDescriptor>());
    participant_ = DomainParticipantFactory::get_instance()->create_participant(
        domain, qos, &others_, StatusMask::none());
    publisher_ = participant_->create_publisher(PUBLISHER_QOS_DEFAULT);
    subscriber_ = participant_->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    std::istringstream writes("reliable transient 1"), reads("reliable transient all");
    graph_ = make(true, "ros_discovery_info", "Entities", writes);
    graph_.reader = make(false, "ros_discovery_info", "Entities", reads).reader;
    tell();
  }
  Peer(const Peer&) = delete;
  Peer& operator=(const Peer&) = delete;
  ~Peer() {
    participant_->delete_contained_entities();
    DomainParticipantFactory::get_instance()->delete_participant(participant_);
  }

  std::string answer(const std::string& line) {
    std::istringstream words(line);
    std::string what, name;
    words >> what >> name;
    if (what == "writer" || what == "reader") {
      std::string topic, type;
      words >> topic >> type;
      const Endpoint made = make(what == "writer", topic, type, words);
      if (made.writer == nullptr && made.reader == nullptr) return "refused";
      endpoints_[name] = made;
      tell();
      return "made";
    }
    if (what == "others") return joined(others_.of_topic(name));
    if (what == "nodes") return nodes();
    const auto found = endpoints_.find(name);
    if (found == endpoints_.end()) return "nobody has this name";
    const Endpoint endpoint = found->second;
    if (what == "matched") return std::to_string(matched(endpoint));
    if (what == "take") return endpoint.type->take(*endpoint.reader);
    if (what == "delete") {
      endpoints_.erase(found);
      tell();
      if (endpoint.writer != nullptr)
        publisher_->delete_datawriter(endpoint.writer);
      else
        subscriber_->delete_datareader(endpoint.reader);
      return "gone";
    }
    std::uint64_t number = 0;
    words >> number;
    if (what == "letters") {
      std::size_t letters = 0;
      words >> letters;
      std_msgs::msg::String message;
      message.data = letters_of(number, letters);
      return endpoint.writer->write(&message) ? "Success" : "not written";
    }
    return endpoint.type->write(*endpoint.writer, number) ? "Success" : "not written";
  }

 private:
  Endpoint make(bool is_writer, const std::string& topic_name, const std::string& type_name,
                std::istringstream& words) {
    const Type& type = types().at(type_name);
    type.support.register_type(participant_);
    TopicDescription* topic = participant_->lookup_topicdescription(topic_name);
    if (topic == nullptr)
      topic =
          participant_->create_topic(topic_name, type.support.get_type_name(), TOPIC_QOS_DEFAULT);
    Endpoint made;
    made.type = &type;
    if (is_writer) {
      DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
      qos.publish_mode().kind = SYNCHRONOUS_PUBLISH_MODE;
      qos.writer_data_lifecycle().autodispose_unregistered_instances = false;
      read(words, qos, type);
      made.writer = publisher_->create_datawriter(static_cast<Topic*>(topic), qos);
    } else {
      DataReaderQos qos = DATAREADER_QOS_DEFAULT;
      read(words, qos, type);
      made.reader = subscriber_->create_datareader(topic, qos);
    }
    return made;
  }
  template <class Qos>
  static void read(std::istringstream& words, Qos& qos, const Type& type) {
    // A reader of a type whose messages are all of one size has no memory for longer ones.
    qos.endpoint().history_memory_policy = type.is_fixed
                                               ? rtps::PREALLOCATED_MEMORY_MODE
                                               : rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    qos.data_sharing().off();
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = VOLATILE_DURABILITY_QOS;
    qos.history().kind = KEEP_LAST_HISTORY_QOS;
    qos.history().depth = 1;
    for (std::string word; words >> word;) {
      if (word == "best") {
        qos.reliability().kind = BEST_EFFORT_RELIABILITY_QOS;
      } else if (word == "transient") {
        qos.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
      } else if (word == "all") {
        qos.history().kind = KEEP_ALL_HISTORY_QOS;
      } else if (word != "reliable") {
        qos.history().depth = std::stoi(word);
        auto& limits = qos.resource_limits();
        limits.max_samples_per_instance =
            std::max(limits.max_samples_per_instance, qos.history().depth);
      }
    }
  }
  static std::int32_t matched(const Endpoint& endpoint) {
    if (endpoint.writer != nullptr) {
      PublicationMatchedStatus status;
      endpoint.writer->get_publication_matched_status(status);
      return status.current_count;
    }
    SubscriptionMatchedStatus status;
    endpoint.reader->get_subscription_matched_status(status);
    return status.current_count;
  }

  /// Announces the own node, completely, as after each change.
  void tell() {
    ParticipantEntitiesInfo info;
    info.gid.data = gid_of(participant_->guid());
    auto& node = info.node_entities_info_seq.emplace_back();
    node.node_namespace = "/";
    node.node_name = "fast_peer";
    for (const auto& [name, endpoint] : endpoints_) {
      auto& list = endpoint.writer != nullptr ? node.writer_gid_seq : node.reader_gid_seq;
      list.emplace_back().data =
          gid_of(endpoint.writer != nullptr ? endpoint.writer->guid() : endpoint.reader->guid());
    }
    graph_.writer->write(&info);
  }
  std::string nodes() {
    ParticipantEntitiesInfo info;
    SampleInfo about;
    while (graph_.reader->take_next_sample(&info, &about) == ReturnCode_t::RETCODE_OK)
      if (about.valid_data) said_[info.gid.data] = info;
    std::vector<std::string> list;
    for (const auto& [gid, of] : said_) {
      if (!others_.is_there(gid)) continue;
      for (const auto& node : of.node_entities_info_seq) {
        std::string text =
            (node.node_namespace == "/" ? "" : node.node_namespace) + "/" + node.node_name;
        for (const auto* const gids : {&node.reader_gid_seq, &node.writer_gid_seq})
          for (const auto& one : *gids)
            text += (gids == &node.reader_gid_seq ? " <" : " >") + others_.topic_of(one.data);
        list.push_back(text);
      }
    }
    return joined(list);
  }

  Others others_;
  DomainParticipant* participant_ = nullptr;
  Publisher* publisher_ = nullptr;
  Subscriber* subscriber_ = nullptr;
  Endpoint graph_;
  std::map<Gid, ParticipantEntitiesInfo> said_;
  std::map<std::string, Endpoint> endpoints_;
};

}  // namespace

int main(int count, char** arguments) {
  if (count < 2) return 2;
  Peer peer(static_cast<DomainId_t>(std::stoul(arguments[1])), count == 2);
  for (std::string line; std::getline(std::cin, line);) std::cout << peer.answer(line) << std::endl;
}
