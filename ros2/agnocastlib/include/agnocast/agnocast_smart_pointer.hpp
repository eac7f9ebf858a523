// SPDX-License-Identifier: Apache-2.0
//
// agnocast::ipc_shared_ptr is that of the library below.
#pragma once

#include <agnocastlib/core.hpp>
