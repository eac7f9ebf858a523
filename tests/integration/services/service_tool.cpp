// SPDX-License-Identifier: Apache-2.0
//
// A node of its own with services or a client, steered line by line:
//
//   serve NAME [DEPTH]    → ok; it answers at once (test::Repeat)
//   defer NAME [DEPTH]    → ok; it keeps its requests
//   unserve               → ok
//   held                  → how many requests are kept
//   answer INDEX          → of one of them, from 0: ok, or the word of the error
//   clients               → that it can answer
//   undelivered           → responses
//   refused               → clients that it cannot answer, and the word of the reason
//   client NAME [DEPTH]   → ok
//   wait MS, ready        → yes, no
//   servers               → that can answer it
//   connected             → yes, no: to the daemon
//   ask VALUE             → the number of the request, or the word of the error
//   result NUMBER         → the response's value, or the word of the error; waits for it

#include <tests/integration/services/services.hpp>
#include <tests/support/processes/spun.hpp>

#include <chrono>
#include <iostream>
#include <map>
#include <mutex>
#include <sstream>
#include <string>
#include <vector>

// libstdc++ counts the references of an exception in code that ThreadSanitizer has not compiled:
// it only sees one thread read the exception of a future, and another one free it.
extern "C" [[gnu::visibility("default")]] const char* __tsan_default_suppressions();
extern "C" const char* __tsan_default_suppressions() {
  return "race:std::__exception_ptr::exception_ptr::_M_release\n";
}

namespace agnocast::test {
namespace {

class Tool {
 public:
  std::string obey(std::istream& line) {
    std::string what;
    line >> what;
    if (what == "serve" || what == "defer") return serve(line, what == "serve");
    if (what == "unserve") return service_.reset(), "ok";
    if (what == "clients") return std::to_string(service_->get_client_count());
    if (what == "undelivered") return std::to_string(service_->get_undelivered_response_count());
    if (what == "refused")
      return std::to_string(service_->get_refused_client_count()) + ' ' +
             word_of(service_->get_last_refusal().code);
    if (what == "held") return with_lock([&] { return std::to_string(held_.size()); });
    if (what == "answer") return answer(number(line));
    if (what == "client") return make_client(line);
    if (what == "ready") return client_->service_is_ready() ? "yes" : "no";
    if (what == "servers") return std::to_string(client_->get_server_count());
    if (what == "wait")
      return client_->wait_for_service(std::chrono::milliseconds(number(line))) ? "yes" : "no";
    if (what == "connected") return connection_state() == ConnectionState::connected ? "yes" : "no";
    if (what == "ask") return ask(number(line));
    if (what == "result") return result(static_cast<std::int64_t>(number(line)));
    return "what?";
  }

 private:
  static std::uint64_t number(std::istream& line, std::uint64_t otherwise = 0) {
    std::uint64_t value = otherwise;
    if (!(line >> value)) value = otherwise;
    return value;
  }
  template <class Do>
  auto with_lock(Do work) -> decltype(work()) {
    const std::lock_guard lock(mutex_);
    return work();
  }

  std::string serve(std::istream& line, bool at_once) {
    std::string name;
    line >> name;
    const QoS qos(number(line, 10));
    auto made = at_once ? try_create_service<Repeat>(
                              node_, name,
                              [](const ipc_shared_ptr<const Repeat::Request>& request,
                                 ipc_shared_ptr<Repeat::Response>& response) {
                                Repeat::answer(*request, *response);
                              },
                              qos)
                        : try_create_service<Repeat>(
                              node_, name,
                              [this](ServiceRequest<Repeat> request) {
                                with_lock([&] { held_.push_back(std::move(request)); });
                              },
                              qos);
    if (!made) return text_of(made.error());
    service_ = std::move(*made);
    return "ok";
  }
  std::string answer(std::size_t index) {
    const ServiceRequest<Repeat> request = with_lock([&] { return held_.at(index); });
    auto response = service_->borrow_loaned_response();
    Repeat::answer(*request, *response);
    return word_of(service_->send_response(request, std::move(response)).code);
  }
  std::string make_client(std::istream& line) {
    std::string name;
    line >> name;
    auto made = try_create_client<Repeat>(node_, name, QoS(number(line, 10)));
    if (!made) return text_of(made.error());
    client_ = std::move(*made);
    return "ok";
  }
  std::string ask(std::uint64_t value) {
    auto request = client_->borrow_loaned_request();
    request->value = value;
    request->count = 100;
    auto sent = client_->try_async_send_request(std::move(request));
    if (!sent) return word_of(sent.error().code);
    const std::int64_t id = sent->request_id;
    futures_.emplace(id, std::move(sent->future));
    return std::to_string(id);
  }
  std::string result(std::int64_t id) {
    auto& future = futures_.at(id);
    if (future.wait_for(std::chrono::minutes(5)) != std::future_status::ready) return "nothing";
    try {
      const auto response = future.get();
      for (const std::uint64_t value : response->values) {
        if (value != response->values.front()) return "damaged";
      }
      return response->values.size() == 100 ? std::to_string(response->values.front()) : "damaged";
    } catch (const Error& error) {
      return word_of(error.failure().code);
    }
  }

  Spun<Node> node_{"tool"};
  std::mutex mutex_;
  std::vector<ServiceRequest<Repeat>> held_;
  Service<Repeat>::SharedPtr service_;
  Client<Repeat>::SharedPtr client_;
  std::map<std::int64_t, Client<Repeat>::Future> futures_;
};

}  // namespace
}  // namespace agnocast::test

int main() {
  agnocast::test::Tool tool;
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream words(line);
    std::cout << tool.obey(words) << std::endl;
  }
}
