// SPDX-License-Identifier: Apache-2.0
//
// service call: a client that takes its request from the command line, a file or standard input,
// and prints the response.

#include <agnocast/generic_service.hpp>
#include <agnocast/relay.hpp>
#include <base/text/text.hpp>
#include <ctl/cli/commands.hpp>
#include <ctl/cli/message_options.hpp>
#include <ctl/commands/live.hpp>
#include <ctl/messages/message_read.hpp>
#include <ctl/messages/message_text.hpp>
#include <ctl/snapshot/select.hpp>

#include <algorithm>
#include <string>
#include <string_view>
#include <utility>

namespace agnocast::ctl {
namespace {

namespace o = options;

using Clock = Live::Clock;

std::string service_type_name(const IntrospectedServiceType& type) {
  std::string name = type_name(type.request.members());
  return name.erase(name.size() - std::string_view("_Request").size());
}

class Caller {
 public:
  Caller(Live& live, GenericClient& client, const IntrospectedServiceType& type,
         const Arguments& arguments, Console& console)
      : live_(live), client_(client), type_(type), arguments_(arguments), console_(console) {}

  Outcome<void> call(const ReadMessage& request) {
    const auto deadline = arguments_.has(o::timeout)
                              ? Clock::now() + Live::seconds(arguments_.real(o::timeout))
                              : Live::for_ever;
    const bool is_text = arguments_.json == Json::no;
    if (is_text && !client_.service_is_ready()) {
      console_.line("waiting for service to become available...");
      (void)write_out();
    }
    auto waited = wait([&] { return client_.service_is_ready(); }, deadline, "it has no server");
    if (!waited) return waited;
    request.set_times(wall_time_ns());
    const Value asked = Value::of(type_.request.members(), request.message.get());
    if (is_text) console_.line("requester: making request: " + flow_yaml_of(asked, {}) + '\n');
    (void)write_out();
    GenericLoan loan = client_.borrow_loaned_request();
    type_.request.assign(request.message.get(), loan.get());
    const auto begin = Clock::now();
    const auto sent = client_.try_async_send_request(
        std::move(loan), [this](const GenericClient::SharedFuture&) { live_.stop(); });
    if (!sent) return problem_of(sent.error(), escaped(client_.get_service_name()));
    waited =
        wait([&] { return sent->future.wait_for(Clock::duration(0)) == std::future_status::ready; },
             deadline, "no response came");
    if (!waited) return waited;
    try {
      const GenericMessage response = sent->future.get();
      const auto copy = try_copy_checked(response);
      if (!copy) return problem_of(copy.error(), escaped(client_.get_service_name()));
      print(asked, Value::of(type_.response.members(), copy->get()), Clock::now() - begin);
    } catch (const Error& error) {
      return problem_of(error.failure(), escaped(client_.get_service_name()));
    }
    return {};
  }

 private:
  template <class Condition>
  Outcome<void> wait(Condition condition, Clock::time_point deadline, const char* otherwise) {
    // Readiness is polled: callbacks are not notified of it.
    constexpr std::chrono::milliseconds step{20};
    const std::string name = escaped(client_.get_service_name());
    while (!condition()) {
      const auto now = Clock::now();
      if (now >= deadline)
        return problem(Status::timed_out, name,
                       std::string(otherwise) + " within " + arguments_.text(o::timeout) + " s",
                       "agnocast-ctl service info -v " + name);
      if (!live_.run_until(std::min(deadline, now + step)))
        return problem(Status::failed, name, std::string(otherwise) + " before a signal",
                       "agnocast-ctl service info -v " + name);
    }
    return {};
  }
  void print(const Value& request, const Value& response, Clock::duration duration) {
    if (arguments_.json == Json::no) {
      std::string text = yaml_of(response, {});
      if (!text.empty()) text.pop_back();
      return console_.line("response:\n" + text);
    }
    console_.object(
        {{"schema", "agnocast.service-call/1"},
         {"service", client_.get_service_name()},
         {"type", service_type_name(type_)},
         {"request", json_of(request, {})},
         {"response", json_of(response, {})},
         {"duration_ns", std::chrono::duration_cast<std::chrono::nanoseconds>(duration).count()}},
        arguments_.json);
  }

  Live& live_;
  GenericClient& client_;
  const IntrospectedServiceType& type_;
  const Arguments& arguments_;
  Console& console_;
};

}  // namespace

Outcome<void> call_service(const Arguments& arguments, Console& console) {
  const auto type = try_find_service_type(arguments.subject(1));
  if (!type) return problem_of(type.error(), escaped(arguments.subject(1)));
  const auto text = values_of(arguments);
  if (!text) return tl::unexpected(text.error());
  const auto requests = read_messages(*text, type->request);
  if (!requests) return tl::unexpected(requests.error());
  auto live = Live::enter(arguments);
  if (!live) return tl::unexpected(live.error());
  const std::string service = fully_qualified(arguments.subject(0));
  const auto client = try_create_generic_client((*live)->node(), service, *type);
  if (!client) return problem_of(client.error(), escaped(service));
  Caller caller(**live, **client, *type, arguments, console);
  const bool is_repeated = arguments.has(o::call_rate);
  auto due = Clock::now();
  for (std::size_t count = 0; is_repeated || count < requests->size(); ++count) {
    if (auto called = caller.call((*requests)[count % requests->size()]); !called) {
      // A series that its user ends has succeeded.
      if (is_repeated && count != 0 && (*live)->is_ended_by_signal()) return {};
      return called;
    }
    if (!write_out()) break;
    if (!is_repeated) continue;
    due = std::max(due + Live::seconds(1 / arguments.real(o::call_rate)), Clock::now());
    while (Clock::now() < due) {
      if (!(*live)->run_until(due)) return {};
    }
  }
  return {};
}

}  // namespace agnocast::ctl
