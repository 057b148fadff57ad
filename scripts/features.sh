#!/usr/bin/env bash
# Prints the cargo flags for what this machine can build beside the default: `--features video` (H.264 in MP4 without another
# program) where a C++ compiler works, else nothing, with a line on standard error that says so.
#
#   POINTILLIST_VIDEO=0|1     leave it out | have it, whatever is found
set -euo pipefail

# As the cc crate looks for it.
compiler=${CXX:-c++}
works() { printf '#include <string>\n' | "$compiler" -x c++ -fsyntax-only - 2>/dev/null; }

case ${POINTILLIST_VIDEO:-} in
1) echo --features video ;;
0) echo "features: built without video (POINTILLIST_VIDEO=0)" >&2 ;;
'')
    if works; then
        echo --features video
    else
        echo "features: built without video: no C++ compiler ($compiler; Debian's package is g++). With ffmpeg on the PATH, videos are made all the same." >&2
    fi
    ;;
*)
    echo "features: POINTILLIST_VIDEO must be 0 or 1" >&2
    exit 2
    ;;
esac
