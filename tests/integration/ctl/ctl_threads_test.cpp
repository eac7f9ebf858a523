// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocast-ctl shows the threads that run callbacks as the kernel has them, with every state
// of their rule, takes nothing of them unasked or out of order, and doctor names each rule that is
// not in force with its cause. Method: a socket of the test that answers as agnocastd does, with
// this process as the only client.

#include <ctl/doctor/doctor_facts.hpp>
#include <tests/integration/ctl/said_daemon.hpp>
#include <tests/support/processes/ctl.hpp>

#include <gmock/gmock.h>

#include <sched.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::test {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

// --- what an observer takes

bool takes(const Answers& answers, ctl::LookOptions options = {.threads = true}) {
  const SaidDaemon daemon(answers);
  auto observer = ctl::Observer::connect(daemon.socket_path());
  if (!observer) {
    ADD_FAILURE() << observer.error().why;
    return false;
  }
  const auto system = observer->look(options);
  if (system && options.threads) {
    EXPECT_EQ(system->callback_groups.size(), answers.groups.size());
    EXPECT_EQ(system->callback_threads.size(), answers.threads.size());
  }
  if (!system) {
    EXPECT_EQ(system.error().status, ctl::Status::failed) << system.error().why;
  }
  return system.has_value();
}

TEST(CtlThreads, AreTakenOnlyWhenAskedFor) {
  Answers answers = this_process();
  answers.groups = {group(0, 1, "/lidar/driver", "control")};
  answers.threads = {thread(77)};
  EXPECT_TRUE(takes(answers));
  EXPECT_TRUE(takes(answers, {}));
  answers.is_unasked = true;
  EXPECT_TRUE(takes(answers));
  EXPECT_FALSE(takes(answers, {}));
}

TEST(CtlThreads, AreRefusedWhenTheyContradictTheDump) {
  const auto with_group = [](auto change) {
    Answers answers = this_process();
    answers.groups = {group(0, 1, "/lidar/driver", "")};
    change(answers.groups[0]);
    return takes(answers);
  };
  using Group = wire::DumpCallbackGroup;
  EXPECT_TRUE(with_group([](Group&) {}));
  EXPECT_FALSE(with_group([](Group& it) { it.client = 4; }));
  EXPECT_FALSE(with_group([](Group& it) { it.client = ~std::uint64_t{0}; }));
  EXPECT_FALSE(with_group([](Group& it) { it.client_generation = 8; }));
  EXPECT_FALSE(with_group([](Group& it) { it.reentrant = 2; }));
  const auto with_thread = [](auto change) {
    Answers answers = this_process();
    answers.threads = {refused(ThreadCall::sched_setattr, EPERM)};
    change(answers.threads[0]);
    return takes(answers);
  };
  using Thread = SaidThread;
  EXPECT_TRUE(with_thread([](Thread&) {}));
  EXPECT_FALSE(with_thread([](Thread& it) { it.client = 4; }));
  EXPECT_FALSE(with_thread([](Thread& it) { it.client_generation = 8; }));
  EXPECT_FALSE(with_thread([](Thread& it) { it.thread = 0; }));
  EXPECT_FALSE(with_thread([](Thread& it) { it.thread = 0x80000000; }));
  EXPECT_FALSE(with_thread([](Thread& it) { it.setting = static_cast<ThreadSetting>(6); }));
  EXPECT_FALSE(with_thread([](Thread& it) { it.call = static_cast<ThreadCall>(3); }));
  EXPECT_FALSE(with_thread([](Thread& it) { it.os_errno = 4096; }));
  EXPECT_FALSE(with_thread([](Thread& it) { it.scheduling.sets_policy = 2; }));
  EXPECT_FALSE(with_thread([](Thread& it) { it.scheduling.sets_cpus = 2; }));
  Answers answers = this_process();
  answers.more_counted.callback_group_count = 1;
  EXPECT_FALSE(takes(answers));
  answers = this_process();
  answers.more_counted.callback_thread_count = 1;
  EXPECT_FALSE(takes(answers));
  answers = this_process();
  for (std::uint32_t i = 1; i <= abi::callback_thread_count_max; ++i)
    answers.threads.push_back(thread(i));
  EXPECT_TRUE(takes(answers));
  answers.threads.push_back(thread(abi::callback_thread_count_max + 1));
  EXPECT_FALSE(takes(answers));
  answers.threads = {thread(77), thread(78), thread(77)};
  EXPECT_FALSE(takes(answers)) << "the same thread twice";
}

TEST(CtlThreads, AreRefusedUnlessTheirExecutorsAreComplete) {
  constexpr std::uint32_t body = wire::thread_executor_count_max;
  const auto with = [](std::vector<SaidThread> threads) {
    Answers answers = this_process();
    answers.threads = std::move(threads);
    return takes(answers);
  };
  const auto counted = [](SaidThread said, std::uint32_t count) {
    said.executor_count = count;
    return said;
  };
  for (const std::uint32_t count : {1u, body - 1, body, body + 1, 3 * body})
    EXPECT_TRUE(with({thread(77, count), thread(78, count)})) << count;
  EXPECT_FALSE(with({counted(thread(77, body), body + 1)})) << "too few at the end";
  EXPECT_FALSE(with({counted(thread(77, body), body + 1), thread(78)})) << "before the next";
  EXPECT_FALSE(with({counted(thread(77, 0), 1), thread(78)}));
  EXPECT_FALSE(with({counted(thread(77, body + 1), body)})) << "too many";
  EXPECT_FALSE(with({counted(thread(77, 1), 0)}));
  SaidThread twice = thread(77, body + 1);
  twice.executors.back() = twice.executors.front();
  EXPECT_FALSE(with({twice}));
  constexpr std::uint32_t most = abi::callback_spin_count_max;
  EXPECT_TRUE(with({thread(77, most)}));
  EXPECT_FALSE(with({thread(77, most + 1)}));
  EXPECT_TRUE(with({thread(77, most / 2), thread(78, most / 2)}));
  EXPECT_FALSE(with({thread(77, most / 2), thread(78, most / 2), thread(79)}));
  Answers answers = this_process();
  answers.threads = {thread(77)};
  answers.more_counted.thread_executors_count = 1;
  EXPECT_FALSE(takes(answers));
  answers.more_counted.thread_executors_count = 0;
  answers.has_executors_first = true;
  EXPECT_FALSE(takes(answers));
}

// --- thread list

TEST(CtlThreads, AreListedAsTheKernelHasThem) {
  Answers answers = this_process();
  answers.groups = {group(1, 5, "/lidar/driver", ""), group(0, 7, "/lidar/driver", "control"),
                    group(69, 2, "/lidar/filter", ""), group(70, 1, "/of/another", "")};
  answers.groups[2].reentrant = 1;
  answers.threads = {thread(own_thread(), 70)};
  const SaidDaemon daemon(answers);
  CtlResult result = run_ctl(daemon.socket_path(), {"thread", "list"});
  EXPECT_EQ(result.status, 0) << result.err;
  const std::string id = std::to_string(own_thread());
  EXPECT_THAT(result.out, testing::MatchesRegex("PID +TID +PROCESS +NODE +GROUP +POLICY +PRIORITY "
                                                "+CPUS +CPU TIME +SET BY\n[0-9]+ +" +
                                                id +
                                                " +lidar +/lidar/driver \\+1 +control \\+2 +other "
                                                "+nice [0-9-]+ +[a-z0-9,-]+ +[0-9.]+ [mnu]?s +\n"));
  result = run_ctl(daemon.socket_path(), {"threads", "-v"});
  EXPECT_THAT(result.out, testing::EndsWith("\n  `- group control of /lidar/driver\n"
                                            "  `- group - of /lidar/driver\n"
                                            "  `- group - of /lidar/filter, reentrant\n"));
  const auto list = run_ctl(daemon.socket_path(), {"threads", "-j"}).json();
  EXPECT_EQ(list["schema"], "agnocast.thread-list/1");
  EXPECT_EQ(list["thread_count"], 1);
  EXPECT_THAT(list["threads_left_out"], IsEmpty());
  const auto& one = list["threads"][0];
  EXPECT_EQ(one["tid"], own_thread());
  EXPECT_EQ(one["pid"], ::getpid());
  EXPECT_EQ(one["client_index"], client);
  EXPECT_EQ(one["executor_count"], 70);
  EXPECT_EQ(one["executors"].size(), 70u);
  EXPECT_EQ(one["executors"][69], 69);
  EXPECT_EQ(one["group_count"], 3);
  EXPECT_EQ(one["groups"][0]["name"], "control");
  EXPECT_EQ(one["groups"][2]["node_name"], "filter");
  EXPECT_EQ(one["groups"][2]["node_namespace"], "/lidar");
  EXPECT_EQ(one["groups"][2]["reentrant"], true);
  EXPECT_EQ(one["kernel"]["policy"], "other");
  cpu_set_t allowed;
  CPU_ZERO(&allowed);
  ASSERT_EQ(::sched_getaffinity(0, sizeof allowed, &allowed), 0);
  EXPECT_EQ(one["kernel"]["cpus"].size(), static_cast<std::size_t>(CPU_COUNT(&allowed)));
  EXPECT_GT(one["cpu_time_ns"], 0);
  EXPECT_TRUE(one["rule"].is_null());
  EXPECT_EQ(run_ctl(daemon.socket_path(), {"dump"}).json()["threads"][0]["tid"], own_thread());
  EXPECT_THAT(run_ctl(daemon.socket_path(), {"threads", "--domain", "4", "-j"}).json()["threads"],
              IsEmpty());
}

TEST(CtlThreads, AreListedWithTheStateOfTheirRule) {
  const auto cell = [](const SaidThread& thread) {
    Answers answers = this_process();
    answers.threads = {thread};
    const SaidDaemon daemon(answers);
    const std::string text = run_ctl(daemon.socket_path(), {"threads"}).out;
    const std::size_t at = text.find("rule at line");
    return at == std::string::npos ? text : text.substr(at, text.find('\n', at) - at);
  };
  EXPECT_EQ(cell(ruled(ThreadSetting::due)), "rule at line 12: due");
  EXPECT_EQ(cell(ruled(ThreadSetting::not_allowed)), "rule at line 12: not allowed");
  EXPECT_EQ(cell(ruled(ThreadSetting::not_found)), "rule at line 12: not found");
  EXPECT_EQ(cell(refused(ThreadCall::sched_setattr, EPERM)),
            "rule at line 12: refused: Operation not permitted");
  auto applied = ruled(ThreadSetting::applied);
  EXPECT_EQ(cell(applied), "rule at line 12: changed since");
  applied.scheduling.policy = SCHED_OTHER;
  EXPECT_EQ(cell(applied), "rule at line 12");
}

TEST(CtlThreads, AreListedWithTheWholeRuleAsJson) {
  Answers answers = this_process();
  answers.threads = {refused(ThreadCall::sched_setaffinity, EINVAL)};
  answers.threads[0].scheduling.sets_cpus = 1;
  answers.threads[0].scheduling.cpus[1] = 5;
  const SaidDaemon daemon(answers);
  const auto rule = run_ctl(daemon.socket_path(), {"threads", "-j"}).json()["threads"][0]["rule"];
  EXPECT_EQ(rule["line"], 12);
  EXPECT_EQ(rule["state"], "refused");
  EXPECT_EQ(rule["call"], "sched_setaffinity");
  EXPECT_EQ(rule["errno"], EINVAL);
  EXPECT_EQ(rule["scheduling"]["policy"], "fifo");
  EXPECT_EQ(rule["scheduling"]["priority"], 50);
  EXPECT_TRUE(rule["scheduling"]["nice"].is_null());
  EXPECT_TRUE(rule["scheduling"]["runtime_ns"].is_null());
  EXPECT_EQ(rule["scheduling"]["cpus"], nlohmann::json({64, 66}));
}

TEST(CtlThreads, AreNotShownUnlessTheyAreOfTheProcess) {
  Answers answers = this_process();
  answers.threads = {thread(static_cast<std::uint32_t>(::getppid())), thread(0x7fffffff)};
  answers.groups = {group(0, 1, "/no\x1b]0;de\n", "\x1b[31m")};
  answers.processes[0].threads_left_out = 5;
  const SaidDaemon daemon(answers);
  const auto list = run_ctl(daemon.socket_path(), {"threads", "-j"}).json();
  ASSERT_EQ(list["thread_count"], 2);
  for (const auto& one : list["threads"]) {
    EXPECT_TRUE(one["kernel"].is_null());
    EXPECT_TRUE(one["cpu_time_ns"].is_null());
  }
  EXPECT_EQ(list["threads_left_out"][0]["count"], 5);
  const std::string text = run_ctl(daemon.socket_path(), {"threads", "-v"}).out;
  EXPECT_THAT(text, HasSubstr("not visible"));
  EXPECT_THAT(text, HasSubstr("\\x1b[31m"));
  EXPECT_EQ(text.find('\x1b'), std::string::npos);
  EXPECT_THAT(text, HasSubstr("not known to the daemon: 5 callback groups and threads of " +
                              process_words() + "\n"));
}

// --- doctor

struct Finding {
  std::string what, cause, remedy;
};

/// Returns the findings about these answers. `change`: of the other facts.
template <class Change>
std::vector<Finding> findings_of(const Answers& answers, Change change) {
  const SaidDaemon daemon(answers);
  auto look = ctl::look_at(daemon.socket_path(), {.threads = true});
  if (!look) {
    ADD_FAILURE() << look.error().why;
    return {};
  }
  // Not on the stack, where GCC 12 takes the optional for uninitialized.
  const auto facts = std::make_unique<ctl::Facts>();
  facts->door.path = daemon.socket_path();
  facts->configuration = "/etc/mine.toml";
  facts->supervisor = 5;
  facts->look = std::move(*look);
  ctl::Arguments everywhere;
  everywhere.all_domains = true;
  facts->threads = ctl::threads_of(facts->system(), everywhere);
  change(*facts);
  EXPECT_EQ(ctl::thread_checks.size(), 1u);
  const ctl::Check& check = ctl::thread_checks.front();
  EXPECT_EQ(check.id, "thread-settings");
  std::vector<Finding> found;
  for (const ctl::Ailment& ailment : check.find(*facts))
    found.push_back(
        {ailment.what, ailment.cause, ctl::filled(check.remedy, ailment.words, facts->common())});
  return found;
}
std::vector<Finding> findings_of(const Answers& answers) {
  return findings_of(answers, [](ctl::Facts&) {});
}
template <class Change>
Finding finding_of(const SaidThread& thread, Change change) {
  Answers answers = this_process();
  answers.threads = {thread};
  const auto found = findings_of(answers, change);
  EXPECT_EQ(found.size(), 1u);
  return found.empty() ? Finding{} : found[0];
}
Finding finding_of(const SaidThread& thread) {
  return finding_of(thread, [](ctl::Facts&) {});
}

std::string subject() {
  return "thread " + std::to_string(own_thread()) + " of " + process_words();
}
constexpr const char* edit = "sudo \"${EDITOR:-vi}\" +12 /etc/mine.toml && kill -HUP 5";

TEST(DoctorThreads, FindsNothingWhereEveryRuleIsInForce) {
  Answers answers = this_process();
  for (const SaidThread& one : {thread(own_thread()), ruled(ThreadSetting::due)}) {
    answers.threads = {one};
    EXPECT_THAT(findings_of(answers), IsEmpty());
  }
  answers.threads = {ruled(ThreadSetting::applied)};
  answers.threads[0].scheduling.policy = SCHED_OTHER;
  EXPECT_THAT(findings_of(answers), IsEmpty());
  answers.threads.assign(3, ruled(ThreadSetting::not_found));
  answers.threads[1].call = ThreadCall::sched_setattr;
  answers.threads[2].setting = ThreadSetting::applied;
  std::uint32_t number = 0x7fffffff;
  for (SaidThread& one : answers.threads) one.thread = number--;
  EXPECT_THAT(findings_of(answers), IsEmpty()) << "they have ended meanwhile";
}

TEST(DoctorThreads, NamesARuleThatIsNotForTheUser) {
  const Finding found = finding_of(ruled(ThreadSetting::not_allowed));
  EXPECT_EQ(found.what, subject() + ": the rule at line 12 matches, and is not for uid " +
                            std::to_string(::geteuid()));
  EXPECT_EQ(found.remedy, edit);
}

TEST(DoctorThreads, NamesThreadsThatTheDaemonDoesNotSee) {
  Answers answers = this_process();
  answers.processes[0].pid = 0;
  answers.threads = {ruled(ThreadSetting::not_found)};
  const auto found = findings_of(answers);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_THAT(found[0].what, HasSubstr("cannot find it, to apply the rule at line 12"));
  EXPECT_THAT(found[0].cause, testing::EndsWith("does not translate numbers of threads"));
  EXPECT_EQ(found[0].remedy, "podman run --pid=host IMAGE");
  const Finding visible = finding_of(ruled(ThreadSetting::not_found));
  EXPECT_THAT(visible.cause, HasSubstr("does not translate numbers of threads"));
  EXPECT_THAT(visible.cause, HasSubstr("the effective user of the thread"));
  EXPECT_EQ(visible.remedy, "podman run --pid=host IMAGE");
}

TEST(DoctorThreads, NamesThreadsThatEndedUnderTheirRule) {
  SaidThread thread = ruled(ThreadSetting::not_found);
  thread.call = ThreadCall::sched_setattr;
  const Finding found = finding_of(thread);
  EXPECT_EQ(found.what, subject() + ": it ended while agnocastd applied the rule at line 12");
  EXPECT_THAT(found.cause, HasSubstr("a new thread with its number"));
}

TEST(DoctorThreads, NamesTheCauseOfARefusal) {
  const auto cause = [](ThreadCall call, int error) {
    const Finding found = finding_of(refused(call, error));
    EXPECT_EQ(found.what,
              subject() + ": " +
                  (call == ThreadCall::sched_setattr ? "sched_setattr" : "sched_setaffinity") +
                  " refused the rule at line 12: " + std::strerror(error));
    EXPECT_EQ(found.remedy, edit);
    return found.cause;
  };
  EXPECT_THAT(cause(ThreadCall::sched_setaffinity, EINVAL), HasSubstr("cpuset"));
  EXPECT_THAT(cause(ThreadCall::sched_setaffinity, EBUSY), HasSubstr("root domain"));
  EXPECT_THAT(cause(ThreadCall::sched_setattr, EBUSY), HasSubstr("admission control"));
  EXPECT_THAT(cause(ThreadCall::sched_setattr, EINVAL), HasSubstr("sched(7)"));
  EXPECT_EQ(cause(ThreadCall::sched_setattr, EIO), "see sched_setattr(2)");
  const Finding none = finding_of(refused(ThreadCall::none, EMFILE));
  EXPECT_THAT(none.cause, HasSubstr("no free descriptor"));
  EXPECT_EQ(none.remedy, "kill -HUP 5");
}

TEST(DoctorThreads, NamesWhatAnOperationNeeds) {
  const auto needs = [](auto change, ThreadCall call = ThreadCall::sched_setattr,
                        std::uint32_t policy = SCHED_FIFO) {
    auto thread = refused(call, EPERM);
    thread.scheduling.policy = policy;
    return finding_of(thread, change);
  };
  const auto nothing = [](ctl::Facts&) {};
  const auto capable = [](ctl::Facts& facts) { facts.daemon.may_schedule_all = true; };
  EXPECT_EQ(needs(nothing).remedy,
            "sudo prlimit --pid " + std::to_string(::getpid()) + " --rtprio=50 && kill -HUP 5");
  for (const Finding& found : {needs(nothing, ThreadCall::sched_setaffinity),
                               needs(nothing, ThreadCall::sched_setattr, SCHED_DEADLINE)}) {
    EXPECT_THAT(found.cause, HasSubstr("AmbientCapabilities=CAP_SYS_NICE"));
    EXPECT_EQ(found.remedy, edit);
  }
  const Finding realtime = needs(capable);
  EXPECT_THAT(realtime.cause, HasSubstr("cpu.rt_runtime_us, with CONFIG_RT_GROUP_SCHED"));
  EXPECT_EQ(realtime.remedy, edit);
  const Finding other = needs(capable, ThreadCall::sched_setattr, SCHED_OTHER);
  EXPECT_THAT(other.cause, HasSubstr("security profile"));
  EXPECT_EQ(other.remedy, edit);
  const Finding deadline = needs(capable, ThreadCall::sched_setattr, SCHED_DEADLINE);
  EXPECT_THAT(deadline.cause, HasSubstr("root domain"));
  EXPECT_EQ(deadline.remedy, edit);
  const Finding system = needs([](ctl::Facts& facts) { facts.door.is_systems = true; });
  EXPECT_THAT(system.remedy, HasSubstr("CapabilityBoundingSet=CAP_SYS_NICE"));
  EXPECT_THAT(system.remedy, testing::EndsWith("&& sudo systemctl restart agnocastd"));
}

TEST(DoctorThreads, NamesValuesThatHaveChangedSince) {
  Finding found = finding_of(ruled(ThreadSetting::applied));
  EXPECT_EQ(found.what, subject() + ": policy other instead of fifo (rule at line 12)");
  EXPECT_EQ(found.remedy, "kill -HUP 5");
  auto bound = ruled(ThreadSetting::applied);
  bound.scheduling.sets_policy = 0;
  bound.scheduling.sets_cpus = 1;
  for (std::uint64_t& word : bound.scheduling.cpus) word = ~std::uint64_t{0};
  found = finding_of(bound);
  EXPECT_THAT(found.what, HasSubstr(" instead of 0-1023 (rule at line 12)"));
  EXPECT_THAT(found.cause, HasSubstr("cpuset"));
  EXPECT_EQ(found.remedy, edit);
}

TEST(DoctorThreads, NamesThreadsOfOneCauseTogether) {
  Answers answers = this_process();
  for (std::uint32_t i = 0; i < 6; ++i) {
    answers.threads.push_back(ruled(ThreadSetting::not_allowed));
    answers.threads.back().thread = 1000 + i;
  }
  const auto found = findings_of(answers);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_THAT(found[0].what, testing::StartsWith("threads 1000, 1001, 1002, 1003 and 2 more of " +
                                                 process_words() + ": the rule "));
}

TEST(DoctorThreads, NamesTheQuotaOfThreadsThatAreUnknown) {
  Answers answers = this_process();
  answers.processes[0].threads_left_out = 3;
  answers.daemon.quota.callback_groups = ~std::uint64_t{0};
  answers.daemon.quota.callback_threads = 8;
  wire::DumpUser user{};
  user.uid = ::geteuid();
  user.use.callback_groups = 100;
  user.use.callback_threads = 8;
  answers.users = {user};
  auto found = findings_of(answers);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].what,
            "3 callback groups and threads of " + process_words() + " are unknown to agnocastd");
  EXPECT_THAT(found[0].cause, HasSubstr("[quota] callback_threads is 8"));
  EXPECT_THAT(found[0].remedy, HasSubstr("callback_threads = 16/"));
  EXPECT_THAT(found[0].remedy, testing::EndsWith(" && kill -HUP 5"));
  answers.users[0].use.callback_threads = 7;
  answers.processes[0].threads_left_out = 1;
  found = findings_of(answers);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].what,
            "1 callback group or thread of " + process_words() + " is unknown to agnocastd");
  EXPECT_THAT(found[0].cause, HasSubstr("1024 threads"));
  EXPECT_THAT(found[0].cause, HasSubstr("[quota] callback_threads also limits"));
  answers.users[0].use.callback_threads = 8;  // and one process has all that it may
  answers.threads = {thread(77, abi::callback_spin_count_max)};
  found = findings_of(answers);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_THAT(found[0].cause,
              HasSubstr("32768 pairs of a thread and an executor, which no [quota] raises"));
  EXPECT_EQ(found[0].remedy, "agnocast-ctl thread list --all-domains");
}

}  // namespace
}  // namespace agnocast::test
