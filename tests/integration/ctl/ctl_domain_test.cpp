// SPDX-License-Identifier: Apache-2.0
//
// Goal: agnocast-ctl shows a node, and its process, in the domain of the node's endpoints, which
// may be another one than that of the process. Method: one process with a node in each of two.

#include <tests/integration/ctl/ctl_node.hpp>
#include <tests/support/processes/ctl.hpp>
#include <tests/support/processes/daemon_process.hpp>

#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

namespace agnocast::test {
namespace {

TEST(CtlDomain, ShowsNodesInTheDomainOfTheirEndpoints) {
  DaemonProcess daemon;
  CtlNode process(daemon.socket_path());
  process.publisher("/points", {7}, "/lidar");
  process.other_domain = 7;
  process.publisher("/points", {7}, "/lidar");
  const auto json = [&](std::vector<std::string> words) {
    words.emplace_back("-j");
    const CtlResult result = run_ctl(daemon.socket_path(), std::move(words));
    EXPECT_EQ(result.status, 0) << result.err;
    return result.json();
  };
  for (const int domain : {0, 7}) {
    const auto nodes = json({"node", "list", "--domain", std::to_string(domain)});
    ASSERT_EQ(nodes["node_count"], 1);
    EXPECT_EQ(nodes["nodes"][0]["domain"], domain);
    EXPECT_EQ(json({"process", "list", "--domain", std::to_string(domain)})["process_count"], 1);
    EXPECT_EQ(json({"dump", "--domain", std::to_string(domain)})["processes"].size(), 1u);
  }
  EXPECT_EQ(json({"node", "list", "--all-domains"})["node_count"], 2);
  EXPECT_EQ(json({"process", "list", "--domain", "8"})["process_count"], 0);
}

}  // namespace
}  // namespace agnocast::test
