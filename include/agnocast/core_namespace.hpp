// SPDX-License-Identifier: Apache-2.0
//
// agnocast::core holds the names to which the package agnocastlib (docs/agnocastlib.md) gives
// another meaning: nodes, publishers, subscriptions, services, their options, their creation.
// Everywhere else the namespace is inline, and agnocast::Publisher is agnocast::core::Publisher.
// A header that agnocastlib includes writes `core::`. A source file uses either this library or
// agnocastlib, not both.
#pragma once

#if defined(AGNOCAST_CORE_IS_HIDDEN)
#define AGNOCAST_CORE_BEGIN namespace core {
#else
#define AGNOCAST_CORE_IS_INLINE
#define AGNOCAST_CORE_BEGIN inline namespace core {
#endif
#define AGNOCAST_CORE_END }
