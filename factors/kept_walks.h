// Walks of which only some keyframes, and the ranges between them, are kept.
#pragma once

#include <vector>

#include "factors/walks.h"

namespace synchronizar {

struct KeptRows {
  std::vector<int> keyframes, users, ranges, lasting;  // those of the whole, in its order
  std::vector<int> first;                              // the first keyframe kept of each user, and the end
  int reference = 0;                                   // among the users
  Numbers new_keyframe, new_lasting;                   // of each of the whole; -1 of what is not kept
};

// `kept` (m) is a run of each user. Users are kept who have any; lasting errors that a range has.
KeptRows kept_rows(const Walks& walks, const Marks& kept);

Walks kept_walks(const Walks& walks, const KeptRows& rows);

WalkStates kept_states(const WalkStates& states, const KeptRows& rows);

// First keyframes are about where the states have them, as nothing else holds a run that begins later.
WalkNoise kept_noise(const WalkNoise& noise, const KeptRows& rows, const Walks& its_walks,
                     const WalkStates& its_states);

}  // namespace synchronizar
