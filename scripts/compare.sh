#!/usr/bin/env bash
# Compares the GPU time and the frames of two builds, which draw the same rows in turns.
#
#   scripts/compare.sh BASE [NEW]  builds both commits; NEW is the working tree by default
#   COMPARE_ROUNDS=7               rounds, in each of which both builds draw a row once, in changing order
#   COMPARE_REPEAT=3               frames of a round, whose median counts
#   COMPARE_ROWS=REGEX             only the rows whose name matches
#
# Worktrees, programs, files and results lie in target/compare/. A commit that was built before is not built again.
set -euo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.."
if [ "$#" -lt 1 ] || [ "$#" -gt 2 ]; then
    echo "usage: scripts/compare.sh BASE [NEW]" >&2
    exit 2
fi
folder=target/compare
mkdir -p "$folder"
# As in scripts/run.sh: no complaints about a Wayland server that is not there.
export NODEVICE_SELECT=${NODEVICE_SELECT-1}

# Builds a commit, and prints the path of its program.
build() { # COMMIT
    local commit
    commit=$(git rev-parse --verify --quiet "$1^{commit}") || {
        echo "compare: there is no commit \`$1\`" >&2
        return 2
    }
    local program="$folder/pointillist-$commit" tree="$folder/tree-$commit"
    if [ ! -x "$program" ]; then
        echo "compare: building $(git log -1 --format='%h %s' "$commit")" >&2
        # What an interrupted run left is made anew.
        git worktree remove --force "$tree" 2>/dev/null || true
        git worktree prune
        git worktree add --quiet --detach "$tree" "$commit"
        (cd "$tree" && cargo build --release --locked --target-dir target --bin pointillist) >&2
        cp "$tree/target/release/pointillist" "$program.part"
        mv "$program.part" "$program"
        git worktree remove --force "$tree"
    fi
    echo "$program"
}

# Writes the scene files of a commit, and prints the folder that holds them.
scenes_of() { # COMMIT
    local root
    root="$folder/scenes-$(git rev-parse --verify --quiet "$1^{commit}")"
    mkdir -p "$root"
    git archive "$1" scenes | tar -x -C "$root"
    echo "$root"
}

base=$(build "$1")
new_root=.
if [ "$#" -eq 2 ]; then
    new=$(build "$2")
    new_root=$(scenes_of "$2")
else
    echo "compare: building the working tree" >&2
    cargo build --release --locked --bin pointillist >&2
    # A copy, so that a build meanwhile does not change what is measured.
    new=$folder/pointillist-working
    cp target/release/pointillist "$new"
fi
python3 scripts/compare.py "$base" "$new" --base-root "$(scenes_of "$1")" --new-root "$new_root" --folder "$folder"
