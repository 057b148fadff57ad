#!/usr/bin/env python3
"""Loads a file of streamlines (TCK, TRK) with nibabel into arrays and prints seconds and memory as JSON.

    nibabel_load.py tracts.tck

Timed is `nibabel.streamlines.load`, without the import of the library. The peak is that of the process, less what it holds before.
"""
import json
import resource
import sys
import time

try:
    import nibabel
except ImportError:
    sys.exit("nibabel_load.py: no nibabel here; run benches/peers/install.sh and use its python")


def resident_mib():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


def main():
    path = sys.argv[1]
    before = resident_mib()
    began = time.perf_counter()
    tractogram = nibabel.streamlines.load(path, lazy_load=False).tractogram
    seconds = time.perf_counter() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({
        "version": nibabel.__version__,
        "seconds": seconds,
        "peak_mib": peak - before,
        "streamlines": len(tractogram.streamlines),
        "points": int(tractogram.streamlines._data.shape[0]),
    }))


if __name__ == "__main__":
    main()
