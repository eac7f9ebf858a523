// SPDX-License-Identifier: Apache-2.0
//
// What <agnocast/agnocast.hpp> is in a target that uses the package agnocastlib: everything but
// message filters and tf2. See docs/agnocastlib.md.
#pragma once

#include <agnocast/agnocast_callback_isolated_executor.hpp>
#include <agnocast/agnocast_client.hpp>
#include <agnocast/agnocast_multi_threaded_executor.hpp>
#include <agnocast/agnocast_publisher.hpp>
#include <agnocast/agnocast_service.hpp>
#include <agnocast/agnocast_single_threaded_executor.hpp>
#include <agnocast/agnocast_subscription.hpp>
#include <agnocast/agnocast_timer.hpp>
#include <agnocast/node/agnocast_context.hpp>
#include <agnocast/node/agnocast_node.hpp>
#include <agnocast/node/agnocast_only_callback_isolated_executor.hpp>
#include <agnocast/node/agnocast_only_multi_threaded_executor.hpp>
#include <agnocast/node/agnocast_only_single_threaded_executor.hpp>
#include <agnocastlib/create.hpp>

#include <rclcpp/rclcpp.hpp>
