// SPDX-License-Identifier: Apache-2.0
//
// The scripts of the process sweeps (see sweep_script.hpp for the syntax): everything that a
// process does with the library, with and without other processes in the middle of it.
#pragma once

#include <tests/recovery/sweep_script.hpp>

#include <cstdint>
#include <cstdlib>
#include <string>

namespace agnocast::sweep {

inline const Script scripts[] = {
    {"a publisher's life",
     "A sub 1 /s 20; sync; V pub 2 /s 20; sync; V publish 2 1; V publish 2 1; A take 1; "
     "V publish 2 1; A take 1; A release; V publish 2 1; V unpub 2; V sync; A drain 1; "
     "A release; V sync; V quit; A drain 1; A unsub 1"},
    {"a subscription's life",
     "A pub 1 /s 20; sync; V sub 2 /s 20; sync; A publish 1 3; V take 2; V take 2; V release; "
     "A publish 1 1; V take 2; V unsub 2; V sync; V release; V release; V sync; A publish 1 1; "
     "V quit; A publish 1 1; A unpub 1"},
    {"a publisher that exits at once",
     "A sub 1 /s 20; sync; V pub 2 /s 20; V publish 2 1; V publish 2 1; V publish 2 1; V quit; "
     "A drain 1; A unsub 1"},
    {"history for a late joiner",
     "V pub 2 /s 5t; V publish 2 1; V publish 2 1; V publish 2 1; A sub 1 /s 5t; sync; "
     "V publish 2 1; A take 1; A drain 1; V unpub 2; V sync; V quit; A release; A drain 1; "
     "A unsub 1"},
    {"one of two publishers",
     "A sub 1 /s 40; B sub 4 /s 40; B pub 3 /s 40; V pub 2 /s 40; sync; B publish 3 2; "
     "V publish 2 1; B publish 3 1; A take 1; V publish 2 1; B drain 4; V unpub 2; V sync; "
     "B publish 3 1; V quit; A release; A drain 1; B drain 4; B unpub 3; sync; A unsub 1; "
     "B unsub 4"},
    {"one of two subscribers",
     "A pub 1 /s 40; B sub 4 /s 40; V sub 2 /s 40; sync; A publish 1 2; V take 2; B take 4; "
     "A publish 1 2; V drain 2; V release; B drain 4; V quit; A publish 1 1; B drain 4; "
     "B release; A unpub 1; sync; B unsub 4"},
    {"a process that publishes to itself and to another",
     "V sub 2 /s 20; V pub 3 /s 20; A sub 1 /s 20; sync; V publish 3 1; V take 2; V publish 3 1; "
     "A take 1; V drain 2; V release; V unsub 2; V publish 3 1; V unpub 3; V sync; V quit; "
     "A release; A drain 1; A unsub 1"},
    {"subscriptions that ignore their own process",
     "V others 2 /s 20; V sub 3 /s 20; V pub 4 /s 20; A pub 5 /s 20; A others 6 /s 20; "
     "A sub 7 /s 20; sync; V publish 4 1; A publish 5 1; V take 2; V drain 3; A take 6; "
     "A drain 7; V unsub 3; V sync; V publish 4 1; A publish 5 1; V take 2; V release; "
     "A take 6; A release; A unsub 7; A sync; V publish 4 1; A publish 5 1; V drain 2; "
     "A drain 6; V unsub 2; V unpub 4; V sync; V release; V quit; A publish 5 1; A release; "
     "A drain 6; A unsub 6; A unpub 5"},
    {"callbacks that sleep and are rung",
     "V cb 2 /s 20; V cb 5 /t 20; V pub 3 /u 20; A cb 1 /u 20; A pub 4 /s 20; sync; "
     "A publish 4 1; V sync; A publish 4 1; V publish 3 1; A sync; V publish 3 1; V unsub 5; "
     "V unsub 2; V unpub 3; V sync; V quit; A heard 1; A unsub 1; A unpub 4"},
    {"more wait sets than publish rings by itself",
     "V cb 2 /s 20; A cb 1 /s 20; B cb 4 /s 20; V pub 3 /s 20; sync; A asleep; B asleep; "
     "V asleep; V publish 3 1; A asleep; B asleep; V asleep; V publish 3 1; V unsub 2; "
     "V publish 3 1; V unpub 3; V sync; V quit; A heard 1; B heard 4; A unsub 1; B unsub 4"},
    {"adoption",
     "A sub 1 /s 20; sync; V pub 2 /s 20; sync; V foreign 2 1; V publish 2 1; A take 1; "
     "V foreign 2 1; A drain 1; A release; V sync; V publish 2 1; V unpub 2; V sync; V quit; "
     "A drain 1; A unsub 1"},
    {"keep-all and a reader that is behind",
     "A sub 1 /s 2a; sync; V pub 2 /s 2a; sync; V publish 2 1; V publish 2 1; V publish 2 1; "
     "A take 1; V publish 2 1; A drain 1; V publish 2 1; A release; V unpub 2; V sync; V quit; "
     "A drain 1; A unsub 1"},
    {"joins and leaves again and again",
     "A sub 1 /s 20; A pub 4 /t 20; sync; V pub 2 /s 20; V sub 3 /t 20; sync; V publish 2 1; "
     "A publish 4 1; V take 3; V unpub 2; V unsub 3; V sync; A drain 1; V pub 5 /s 20; "
     "V sub 6 /t 20; sync; V publish 5 1; A publish 4 1; V drain 6; V release; A drain 1; "
     "V unpub 5; V unsub 6; V sync; V quit; A drain 1; A unsub 1; A unpub 4"},
    {"a publisher that dies while others hold, and its forked child",
     "A sub 1 /s 20; B sub 4 /s 20; sync; V pub 2 /s 20; sync; V publish 2 1; V publish 2 1; "
     "A take 1; B take 4; V fork; V publish 2 1; V unpub 2; V sync; A release; V sync; V quit; "
     "B release; A drain 1; B drain 4; A unsub 1; B unsub 4"},
    {"a subscriber of a publisher that leaves",
     "A pub 1 /s 20; sync; V sub 2 /s 20; sync; A publish 1 3; V take 2; A unpub 1; A sync; "
     "V drain 2; V release; V sync; A pub 3 /s 20; sync; A publish 3 1; V drain 2; V unsub 2; "
     "V sync; V quit; A unpub 3"},
    {"a publisher whose subscribers come and go",
     "A sub 1 /s 20; B sub 4 /s 20; sync; V pub 2 /s 20; sync; V publish 2 1; A drain 1; "
     "B take 4; A unsub 1; V sync; V publish 2 1; B release; B drain 4; B unsub 4; V sync; "
     "V publish 2 1; A sub 3 /s 20; sync; V publish 2 1; A take 3; A unsub 3; V sync; "
     "V publish 2 1; A release; V sync; V unpub 2; V sync; V quit"},
    {"windows are added",
     "A sub 1 /s 30t; V pub 2 /s 30t; sync; V big 2 10; V arm; V big 2 2; V sync; V big 2 3; "
     "V sync; A sync; A take 1; A drain 1; V big 2 1; V unpub 2; V sync; V quit; A release; "
     "A drain 1; A unsub 1"},
    {"windows of another are added",
     "B pub 3 /w 30t; A sub 1 /w 30t; sync; B big 3 10; V sub 4 /w 30t; V sync; V take 4; "
     "B big 3 4; B sync; V sync; V drain 4; V release; V unsub 4; V sync; V quit; A drain 1; "
     "B unpub 3; A unsub 1"},
    {"one that is revoked, and lives on",
     "A sub 1 /s 20; B sub 4 /s 20; A pub 5 /t 20; sync; V pub 2 /s 20; V sub 3 /t 20; "
     "V cb 6 /t 20; sync; V publish 2 2; A publish 5 2; V take 3; A take 1; V arm; revoke; "
     "V orphaned; V publish 2 1; V take 3; A sync; B sync; A drain 1; B drain 4; A publish 5 1; "
     "A release; V drop; V unsub 3; V unpub 2; V quit; A unpub 5; A unsub 1; B unsub 4"},
    {"a daemon that is killed and goes on",
     "A sub 1 /s 20; A pub 4 /t 20; sync; V pub 2 /s 20; V sub 3 /t 20; sync; V publish 2 1; "
     "A publish 4 1; V take 3; V arm; restart; V publish 2 1; sync; A publish 4 1; V take 3; "
     "V quit; A publish 4 1; A drain 1; A unsub 1; A unpub 4"},
    // After a loss "take" finds earlier messages; later ones only when all have moved.
    {"the store is lost under a publisher with a loan",
     "A sub 1 /s 20; B sub 4 /s 20; sync; V pub 2 /s 20; sync; V publish 2 3; A take 1; "
     "V borrow 2; V arm; lose; V publish 2 1; A take 1; connected; V publish 2 1; V commit 2 1; "
     "moved; sync; V publish 2 1; A drain 1; B take 4; A release; A release; B drain 4; "
     "B release; settled; V publish 2 1; A take 1; V sync; V unpub 2; V sync; V quit; "
     "A release; B drain 4; A drain 1; A unsub 1; B unsub 4"},
    {"the store is lost under subscriptions, one with a callback",
     "A pub 1 /s 20; B sub 4 /s 20; sync; V sub 2 /s 20; V cb 6 /s 20; sync; A publish 1 3; "
     "V take 2; B take 4; V arm; lose; A publish 1 1; V take 2; connected; A publish 1 1; "
     "moved; sync; A publish 1 1; V drain 2; V release; V release; B drain 4; B release; "
     "settled; A publish 1 1; V take 2; V unsub 2; V unsub 6; V sync; V release; V quit; "
     "A publish 1 1; B drain 4; A unpub 1; sync; B unsub 4"},
    {"the store is lost under both, with history",
     "V pub 2 /s 3t; V sub 3 /s 5t; A pub 4 /t 3t; V sub 5 /t 5t; A sub 1 /s 5t; sync; "
     "V publish 2 4; A publish 4 4; V take 5; A take 1; V take 3; V borrow 2; V arm; lose; "
     "connected; moved; sync; B sub 7 /s 5t; sync; B take 7; V commit 2 1; A publish 4 1; "
     "A drain 1; V drain 3; V drain 5; V release; A release; V unsub 3; V unpub 2; V sync; "
     "V release; V quit; B drain 7; B release; A drain 1; A unsub 1; B unsub 7; A unpub 4"},
    {"the store is lost while a reader is stopped, and a publisher ends",
     "A sub 1 /s 20; B sub 4 /s 20; sync; V pub 2 /s 20; sync; V publish 2 2; A take 1; V arm; "
     "A stop; lose; V connected; V publish 2 1; V unpub 2; A cont; connected; moved; A drain 1; "
     "A release; B drain 4; V sync; V quit; A unsub 1; B unsub 4"},
    {"the store is lost, and the heap has to grow while a reader is stopped",
     "A cb 1 /s 30t; V pub 2 /s 30t; sync; V big 2 8; V sync; V arm; A stop; lose; V connected; "
     "V later 2 3; A cont; connected; V done 2 3; moved; V sync; A sync; V big 2 1; A heard 1; "
     "V unpub 2; V sync; V quit; A unsub 1"},
    {"the store is lost again and again",
     "A sub 1 /s 20; A pub 4 /t 20; sync; V pub 2 /s 20; V sub 3 /t 20; sync; V publish 2 2; "
     "A publish 4 2; A take 1; V take 3; V arm; lose; moved; V publish 2 1; A publish 4 1; "
     "lose; lose; V publish 2 1; A publish 4 1; A take 1; V take 3; moved; sync; V publish 2 1; "
     "A publish 4 1; A drain 1; V drain 3; V release; A release; V quit; A release; A unsub 1; "
     "A unpub 4"},
};

inline std::uint64_t number_of(const char* name, std::uint64_t otherwise) {
  const char* const text = std::getenv(name);
  return text != nullptr ? std::strtoull(text, nullptr, 0) : otherwise;
}

inline bool runs_everything() {
  const char* const extent = std::getenv("AGNOCAST_SWEEP");
  return extent != nullptr && std::string(extent) == "all";
}

}  // namespace agnocast::sweep
