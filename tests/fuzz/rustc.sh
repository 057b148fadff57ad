#!/bin/sh
# rustc for `make fuzz`: instruments the crates that read bytes from outside, and leaves alone those that draw, encode or talk to
# the network. Counters that no input reaches cost time in every execution. The flags are those of `cargo fuzz --sanitizer none`.
set -eu
crate=
previous=
for argument; do
    [ "$previous" = --crate-name ] && crate=$argument
    previous=$argument
done
case $crate in
base64 | e57 | exr | fdeflate | flate2 | form_urlencoded | gltf | gltf_json | image | image_webp | las | laz | miniz_oxide | pointillist | png | roxmltree | serde_json | serde_path_to_error | serde_urlencoded | tobj | toml | toml_parser | zip | zune_jpeg)
    exec "$@" --cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 \
        -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table \
        -Cllvm-args=-sanitizer-coverage-trace-compares
    ;;
*) exec "$@" ;;
esac
