// Takes the place of the C library's calls with which the calibration store touches the medium, in the program that
// links faulty_calls.cpp: each call is counted, and one of them, or all from one on, is struck.
#pragma once

#include <functional>

namespace ruffini::test {

struct Strike {
  int at = 0;             // of the counted calls, from 1; 0: none
  bool is_after = false;  // the call is made first
  bool is_forever = false;
  int error = 0;                       // errno of the failing call; 0: `stop` is called instead
  int n_bytes = -1;                    // a read or write that moves no more than this; -1: none
  std::function<void()> stop = [] {};  // does not return
  bool is_of_writing = false;          // calls that only look at the medium are neither counted nor struck
  bool has_no_sync = false;            // fsync only counts: what it costs is not the point
};

// From now on calls count; those of other code in between do, too.
void arm(const Strike& strike);
// How many there were.
int disarm();

}  // namespace ruffini::test
