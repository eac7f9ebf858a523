// SPDX-License-Identifier: Apache-2.0
//
// A program of Cyclone DDS without any of our code: its C interface, types of idlc, and names as
// ROS 2 has them in DDS. Steered line by line:
//   plain_peer DOMAIN
//     writer NAME TOPIC TYPE QOS…      TYPE: String, Cloud, Markers
//                                      QOS: best or reliable, transient, all or a depth
//     reader NAME TOPIC TYPE QOS…
//     matched NAME                     how many
//     write NAME NUMBER                the message of that number (values.hpp)
//     take NAME                        the next message, as text; "none" without one
//     others TOPIC                     endpoints that other participants announce: a sorted list
//     delete NAME

#include <tests/integration/bridge/programs/values.hpp>

#include <dds/dds.h>
#include <ros_types.h>

#include <algorithm>
#include <functional>
#include <iostream>
#include <map>

namespace {

using namespace agnocast::test;

struct Type {
  const dds_topic_descriptor_t* descriptor;
  std::function<dds_return_t(dds_entity_t, std::uint64_t)> write;
  std::function<std::string(const void*)> text;
};

template <class C, class See>
Type type_of(const dds_topic_descriptor_t* descriptor) {
  return {descriptor,
          [descriptor](dds_entity_t writer, std::uint64_t number) {
            auto* const sample = static_cast<C*>(dds_alloc(sizeof(C)));
            set_values<See>(number, *sample);
            const dds_return_t code = dds_write(writer, sample);
            dds_sample_free(sample, descriptor, DDS_FREE_ALL);
            return code;
          },
          [](const void* sample) { return text_of<See>(*static_cast<const C*>(sample)); }};
}

const std::map<std::string, Type> types = {
    {"String", type_of<std_msgs_msg_dds__String_, SeeString>(&std_msgs_msg_dds__String__desc)},
    {"Cloud",
     type_of<sensor_msgs_msg_dds__PointCloud2_, SeeCloud>(&sensor_msgs_msg_dds__PointCloud2__desc)},
    {"Markers", type_of<visualization_msgs_msg_dds__MarkerArray_, SeeMarkers>(
                    &visualization_msgs_msg_dds__MarkerArray__desc)}};

struct Endpoint {
  dds_entity_t entity;
  bool is_writer;
  const Type* type;
};

class Peer {
 public:
  explicit Peer(dds_domainid_t domain)
      : participant_(dds_create_participant(domain, nullptr, nullptr)) {
    for (const auto topic : {DDS_BUILTIN_TOPIC_DCPSPUBLICATION, DDS_BUILTIN_TOPIC_DCPSSUBSCRIPTION})
      builtin_.push_back(dds_create_reader(participant_, topic, nullptr, nullptr));
  }

  std::string answer(const std::string& line) {
    std::istringstream words(line);
    std::string what, name;
    words >> what >> name;
    if (what == "writer" || what == "reader") return make(what == "writer", name, words);
    if (what == "others") return others(name);
    const auto found = endpoints_.find(name);
    if (found == endpoints_.end()) return "nobody has this name";
    const Endpoint& endpoint = found->second;
    if (what == "matched") return std::to_string(matched(endpoint));
    if (what == "take") return take(endpoint);
    if (what == "delete") {
      dds_delete(endpoint.entity);
      endpoints_.erase(found);
      return "gone";
    }
    std::uint64_t number = 0;
    words >> number;
    return dds_strretcode(endpoint.type->write(endpoint.entity, number));
  }

 private:
  std::string make(bool is_writer, const std::string& name, std::istringstream& words) {
    std::string topic, type, word;
    words >> topic >> type;
    bool is_reliable = true, is_transient = false, is_all = false;
    std::int32_t depth = 1;
    while (words >> word) {
      if (word == "best")
        is_reliable = false;
      else if (word == "transient")
        is_transient = true;
      else if (word == "all")
        is_all = true;
      else if (word != "reliable")
        depth = std::stoi(word);
    }
    dds_qos_t* const qos = dds_create_qos();
    const auto history = is_all ? DDS_HISTORY_KEEP_ALL : DDS_HISTORY_KEEP_LAST;
    dds_qset_reliability(qos, is_reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT,
                         DDS_INFINITY);
    dds_qset_history(qos, history, depth);
    dds_qset_durability(qos,
                        is_transient ? DDS_DURABILITY_TRANSIENT_LOCAL : DDS_DURABILITY_VOLATILE);
    if (is_transient)
      dds_qset_durability_service(qos, 0, history, depth, DDS_LENGTH_UNLIMITED,
                                  DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED);
    const Type& of = types.at(type);
    const dds_entity_t made =
        dds_create_topic(participant_, of.descriptor, topic.c_str(), nullptr, nullptr);
    const dds_entity_t entity = is_writer ? dds_create_writer(participant_, made, qos, nullptr)
                                          : dds_create_reader(participant_, made, qos, nullptr);
    dds_delete(made);
    dds_delete_qos(qos);
    if (entity < 0) return dds_strretcode(entity);
    endpoints_[name] = {entity, is_writer, &of};
    return "made";
  }
  static std::uint32_t matched(const Endpoint& endpoint) {
    if (endpoint.is_writer) {
      dds_publication_matched_status_t status{};
      dds_get_publication_matched_status(endpoint.entity, &status);
      return status.current_count;
    }
    dds_subscription_matched_status_t status{};
    dds_get_subscription_matched_status(endpoint.entity, &status);
    return status.current_count;
  }
  static std::string take(const Endpoint& endpoint) {
    for (;;) {
      void* sample = nullptr;
      dds_sample_info_t info;
      if (dds_take(endpoint.entity, &sample, &info, 1, 1) <= 0) return "none";
      const std::string text = info.valid_data ? endpoint.type->text(sample) : "";
      dds_return_loan(endpoint.entity, &sample, 1);
      if (info.valid_data) return text;
    }
  }
  std::string others(const std::string& topic) {
    dds_guid_t own{};
    dds_get_guid(participant_, &own);
    std::vector<std::string> list;
    for (std::size_t i = 0; i < builtin_.size(); ++i) {
      void* samples[256] = {};
      dds_sample_info_t infos[256];
      const dds_return_t count = dds_read(builtin_[i], samples, infos, 256, 256);
      for (int n = 0; n < count; ++n) {
        const auto& endpoint = *static_cast<dds_builtintopic_endpoint_t*>(samples[n]);
        if (infos[n].instance_state != DDS_IST_ALIVE || !infos[n].valid_data ||
            endpoint.topic_name != topic ||
            std::equal(std::begin(own.v), std::end(own.v), endpoint.participant_key.v))
          continue;
        list.push_back(std::string(i == 0 ? "writer " : "reader ") + endpoint.type_name +
                       words_of(endpoint.qos));
      }
      if (count > 0) dds_return_loan(builtin_[i], samples, count);
    }
    std::sort(list.begin(), list.end());
    std::string text;
    for (const std::string& one : list) text += (text.empty() ? "" : ", ") + one;
    return text;
  }
  static std::string words_of(const dds_qos_t* qos) {
    dds_reliability_kind_t reliability{};
    dds_durability_kind_t durability{};
    dds_history_kind_t history{};
    dds_liveliness_kind_t liveliness{};
    dds_duration_t time = 0, lifespan = 0, deadline = 0, lease = 0;
    std::int32_t depth = 0;
    void* user_data = nullptr;
    std::size_t size = 0;
    dds_qget_reliability(qos, &reliability, &time);
    dds_qget_durability(qos, &durability);
    dds_qget_history(qos, &history, &depth);
    dds_qget_lifespan(qos, &lifespan);
    dds_qget_deadline(qos, &deadline);
    dds_qget_liveliness(qos, &liveliness, &lease);
    dds_qget_userdata(qos, &user_data, &size);
    std::string text = reliability == DDS_RELIABILITY_RELIABLE ? " reliable" : " best";
    if (durability == DDS_DURABILITY_TRANSIENT_LOCAL) text += " transient";
    text += history == DDS_HISTORY_KEEP_ALL ? " all" : " " + std::to_string(depth);
    if (lifespan != DDS_INFINITY || deadline != DDS_INFINITY || lease != DDS_INFINITY ||
        liveliness != DDS_LIVELINESS_AUTOMATIC)
      text += " timed";
    if (size > 0) text += " said " + std::string(static_cast<char*>(user_data), size);
    dds_free(user_data);
    return text;
  }

  dds_entity_t participant_;
  std::vector<dds_entity_t> builtin_;
  std::map<std::string, Endpoint> endpoints_;
};

}  // namespace

int main(int count, char** arguments) {
  if (count != 2) return 2;
  Peer peer(static_cast<dds_domainid_t>(std::stoul(arguments[1])));
  for (std::string line; std::getline(std::cin, line);) std::cout << peer.answer(line) << std::endl;
}
