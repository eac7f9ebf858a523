// SPDX-License-Identifier: Apache-2.0
//
// A process with agnocast endpoints of std_msgs/String, steered line by line:
//   local_peer
//     pub NAME TOPIC QOS…     QOS: best, transient, all, a depth
//     sub NAME TOPIC QOS…
//     publish NAME COUNT      "NAME#0", "NAME#1", …: continues the count
//     take NAME               all messages there: PUBLISHER/TEXT, each followed by a space
//     delete NAME
// and with services of example_interfaces/AddTwoInts:
//     serve NAME SERVICE ADD  answers with the sum and ADD
//     served NAME             how many it has answered
//     client NAME SERVICE
//     ready NAME              "yes" or "no"
//     call NAME A B           "sent", or why not
//     ended NAME              calls that ended since: "SUM" or "failed", each and a space
//     pending NAME            how many have not ended

#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/spun.hpp>

#include <agnocast/agnocast.hpp>

#include <example_interfaces/srv/add_two_ints.hpp>
#include <std_msgs/msg/string.hpp>

#include <atomic>
#include <chrono>
#include <iostream>
#include <list>
#include <map>
#include <memory>
#include <sstream>
#include <string>

namespace {

using example_interfaces::srv::AddTwoInts;
using std_msgs::msg::String;

struct Publishing {
  agnocast::Publisher<String>::SharedPtr publisher;
  std::uint64_t next = 0;
};

struct Serving {
  agnocast::Service<AddTwoInts>::SharedPtr service;
  std::shared_ptr<std::atomic<std::uint64_t>> count;
};
using Calling = agnocast::Client<AddTwoInts>;
struct Asking {
  Calling::SharedPtr client;
  std::list<Calling::FutureAndRequestId> calls;
};

class Peer {
 public:
  // Long because each command has its branch.
  std::string answer(const std::string& line) {
    std::istringstream words(line);
    std::string what, name;
    words >> what >> name;
    if (what == "serve") {
      std::string service;
      std::int64_t add = 0;
      words >> service >> add;
      const auto count = std::make_shared<std::atomic<std::uint64_t>>(0);
      services_[name] = {
          agnocast::create_service<AddTwoInts>(
              service_node_, service,
              [add, count](const agnocast::ipc_shared_ptr<const AddTwoInts::Request>& request,
                           agnocast::ipc_shared_ptr<AddTwoInts::Response>& response) {
                response->sum = request->a + request->b + add;
                ++*count;
              }),
          count};
      return "made";
    }
    if (what == "served") return std::to_string(*services_.at(name).count);
    if (what == "client") {
      std::string service;
      words >> service;
      clients_[name].client = agnocast::create_client<AddTwoInts>(service_node_, service);
      return "made";
    }
    if (what == "ready") return clients_.at(name).client->service_is_ready() ? "yes" : "no";
    if (what == "pending") return std::to_string(clients_.at(name).calls.size());
    if (what == "call") return call(clients_.at(name), words);
    if (what == "ended") return ended(clients_.at(name));
    if (what == "pub" || what == "sub") {
      std::string topic, word;
      words >> topic;
      agnocast::QoS qos(10);
      while (words >> word) {
        if (word == "best")
          qos.best_effort();
        else if (word == "transient")
          qos.transient_local();
        else if (word == "all")
          qos.keep_all(1000);
        else if (word != "reliable")
          qos.keep_last(std::stoul(word));
      }
      if (what == "pub")
        publishers_[name] = {agnocast::create_publisher<String>(node_, topic, qos)};
      else
        subscriptions_[name] = agnocast::create_subscription<String>(node_, topic, qos);
      return "made";
    }
    if (what == "delete")
      return publishers_.erase(name) + subscriptions_.erase(name) > 0 ? "gone" : "?";
    if (what == "take") {
      std::string all;
      while (const auto message = subscriptions_.at(name)->take())
        all += std::to_string(message.info().publisher) + "/" + message->data + " ";
      return all;
    }
    std::size_t count = 0;
    words >> count;
    Publishing& by = publishers_.at(name);
    for (; count > 0; --count) {
      auto loan = by.publisher->borrow_loaned_message();
      loan->data = name + "#" + std::to_string(by.next++);
      if (const auto result = by.publisher->publish(std::move(loan)); !result)
        return agnocast::sentence_of(result.code);
    }
    return "published";
  }

 private:
  static std::string call(Asking& by, std::istringstream& words) {
    auto request = by.client->borrow_loaned_request();
    words >> request->a >> request->b;
    auto sent = by.client->try_async_send_request(std::move(request));
    if (!sent) return agnocast::sentence_of(sent.error().code);
    by.calls.push_back(std::move(*sent));
    return "sent";
  }
  static std::string ended(Asking& of) {
    std::string all;
    for (auto at = of.calls.begin(); at != of.calls.end();) {
      if (at->wait_for(std::chrono::seconds(0)) != std::future_status::ready) {
        ++at;
        continue;
      }
      try {
        all += std::to_string(at->get()->sum) + " ";
      } catch (const agnocast::Error&) {
        all += "failed ";
      }
      at = of.calls.erase(at);
    }
    return all;
  }

  agnocast::Node node_{"local_peer"};
  agnocast::test::Spun<agnocast::test::PlainNode> service_node_;
  std::map<std::string, Publishing> publishers_;
  std::map<std::string, agnocast::Subscription<String>::SharedPtr> subscriptions_;
  std::map<std::string, Serving> services_;
  std::map<std::string, Asking> clients_;
};

}  // namespace

int main() {
  Peer peer;
  for (std::string line; std::getline(std::cin, line);) {
    try {
      std::cout << peer.answer(line) << std::endl;
    } catch (const std::exception& error) {
      std::cout << error.what() << std::endl;
    }
  }
}
