// SPDX-License-Identifier: Apache-2.0
//
// A client or a server of AddTwoInts without any of our code: Cyclone DDS' C interface, types of
// idlc, and every step as rmw_cyclonedds does it. Steered line by line:
//   plain_service DOMAIN client|server SERVICE ID
//     matched              "REQUESTS REPLIES", how many
//     ask NUMBER A B       of a client
//     take                 of a client: the next response to it, "NUMBER SUM"; "none"
//     next                 of a server: the next request, "CLIENT NUMBER A B"; "none"
//     answer CLIENT NUMBER SUM

#include <dds/dds.h>
#include <ros_service.h>

#include <iostream>
#include <memory>
#include <sstream>
#include <string>

namespace {

using Request = example_interfaces_srv_dds__AddTwoInts_Request_;
using Response = example_interfaces_srv_dds__AddTwoInts_Response_;

class Service {
 public:
  Service(dds_domainid_t domain, bool is_server, const std::string& service, std::uint64_t id)
      : is_server_(is_server),
        id_(id),
        participant_(dds_create_participant(domain, nullptr, nullptr)) {
    const std::string name = (is_server ? "serviceid= 1.10.5b.f7.ca.d7.1d.3b.7c.b5.cb.3a.0.0.0."
                                        : "clientid= 1.10.5b.f7.ca.d7.1d.3b.7c.b5.cb.3a.0.0.0.") +
                             std::to_string(id % 10) + ";";
    const std::unique_ptr<dds_qos_t, decltype(&dds_delete_qos)> qos(dds_create_qos(),
                                                                    &dds_delete_qos);
    dds_qset_reliability(qos.get(), DDS_RELIABILITY_RELIABLE, DDS_INFINITY);
    dds_qset_history(qos.get(), DDS_HISTORY_KEEP_LAST, 10);
    dds_qset_userdata(qos.get(), name.data(), name.size());
    const dds_entity_t requests =
        topic("rq" + service + "Request", &example_interfaces_srv_dds__AddTwoInts_Request__desc);
    const dds_entity_t replies =
        topic("rr" + service + "Reply", &example_interfaces_srv_dds__AddTwoInts_Response__desc);
    writer_ = dds_create_writer(participant_, is_server ? replies : requests, qos.get(), nullptr);
    reader_ = dds_create_reader(participant_, is_server ? requests : replies, qos.get(), nullptr);
  }

  std::string answer(const std::string& line) {
    std::istringstream words(line);
    std::string what;
    words >> what;
    if (what == "matched") return matched();
    if (what == "ask") {
      Request request{};
      request.client_id = id_;
      words >> request.sequence_number >> request.a >> request.b;
      return dds_strretcode(dds_write(writer_, &request));
    }
    if (what == "answer") {
      Response response{};
      words >> response.client_id >> response.sequence_number >> response.sum;
      return dds_strretcode(dds_write(writer_, &response));
    }
    return is_server_ ? next() : take();
  }

 private:
  dds_entity_t topic(const std::string& name, const dds_topic_descriptor_t* type) const {
    return dds_create_topic(participant_, type, name.c_str(), nullptr, nullptr);
  }
  std::string matched() const {
    dds_publication_matched_status_t written{};
    dds_subscription_matched_status_t read{};
    dds_get_publication_matched_status(writer_, &written);
    dds_get_subscription_matched_status(reader_, &read);
    const auto text = [](std::uint32_t number) { return std::to_string(number); };
    return is_server_ ? text(read.current_count) + ' ' + text(written.current_count)
                      : text(written.current_count) + ' ' + text(read.current_count);
  }
  template <class Sample, class Text>
  std::string take_one(const Text& text_of) const {
    for (;;) {
      void* sample = nullptr;
      dds_sample_info_t info;
      if (dds_take(reader_, &sample, &info, 1, 1) <= 0) return "none";
      const std::string text = info.valid_data ? text_of(*static_cast<const Sample*>(sample)) : "";
      dds_return_loan(reader_, &sample, 1);
      if (!text.empty()) return text;
    }
  }
  std::string take() const {
    return take_one<Response>([&](const Response& response) {
      // All clients of a service share the topic.
      return response.client_id != id_
                 ? std::string()
                 : std::to_string(response.sequence_number) + ' ' + std::to_string(response.sum);
    });
  }
  std::string next() const {
    return take_one<Request>([](const Request& request) {
      return std::to_string(request.client_id) + ' ' + std::to_string(request.sequence_number) +
             ' ' + std::to_string(request.a) + ' ' + std::to_string(request.b);
    });
  }

  bool is_server_;
  std::uint64_t id_;
  dds_entity_t participant_, writer_ = 0, reader_ = 0;
};

}  // namespace

int main(int count, char** arguments) {
  if (count != 5) return 2;
  Service service(static_cast<dds_domainid_t>(std::stoul(arguments[1])),
                  std::string(arguments[2]) == "server", arguments[3], std::stoull(arguments[4]));
  for (std::string line; std::getline(std::cin, line);)
    std::cout << service.answer(line) << std::endl;
}
