# What CI runs, one recipe a step. `just` lists the recipes; `just ci` runs them all.
# Install just with `cargo install just` or `pip install rust-just`.

set shell := ["bash", "-euo", "pipefail", "-c"]

# Where the recorded runs are unpacked. They are not part of the repository; see docs/src/benchmarks.md.
data := env("DRIFTLESS_DATA", justfile_directory() / "target/data")

# The profile in which the demo and the tests on recorded runs are built.
profile := env("DRIFTLESS_PROFILE", "release")

[private]
default:
    @just --list --unsorted

# Everything that must hold before a change lands
ci: fmt clippy doc test recorded python demo

# Formatting
fmt:
    cargo fmt --all --check

# Lints, all targets and features
clippy:
    cargo clippy --workspace --all-targets --locked -- -D warnings

# Lints of the program that leaves out what can be left out
clippy-slim:
    cargo clippy -p driftless-tools --no-default-features --locked -- -D warnings

# API documentation
doc:
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --locked

# The demo, with bounds on what it reaches; leaves its map, run and pictures in target/ci-demo
demo:
    rm -rf "{{ justfile_directory() }}/target/ci-demo"
    DEMO_OUT="{{ justfile_directory() }}/target/ci-demo" \
        cargo test --profile {{ profile }} --locked --workspace --test main -- --include-ignored --nocapture demo::

# Tests on recorded runs but those that take minutes; says so where the recordings are not unpacked
recorded:
    #!/usr/bin/env bash
    set -euo pipefail
    if [ ! -d "{{ data }}" ]; then
        echo "SKIPPED: the recorded runs are not unpacked in {{ data }}; their tests were not run"
        exit 0
    fi
    cargo test --profile {{ profile }} --locked --workspace --test main -- --ignored recorded:: images:: --skip images::learned --skip recorded::long

# The Python client against a map server and a robot; says so where its packages cannot be installed
python:
    #!/usr/bin/env bash
    set -euo pipefail
    venv="{{ justfile_directory() }}/target/python"
    if ! { python3 -m venv "$venv" && "$venv/bin/pip" install --quiet './python[test]'; }; then
        echo "SKIPPED: the packages of python/ cannot be installed; its tests were not run"
        exit 0
    fi
    "$venv/bin/mypy" --config-file python/pyproject.toml python/driftless
    cargo test --quiet --profile {{ profile }} --locked --workspace --no-run
    DRIFTLESS_PROGRAMS="{{ justfile_directory() }}/target/{{ if profile == "dev" { "debug" } else { profile } }}" \
        "$venv/bin/python" -m pytest -q python/tests

# All tests; those on recorded runs are listed as ignored. Tests that wait run beside those that compute, with cargo-nextest (where it is
# installed) those of different programs, too.
test:
    #!/usr/bin/env bash
    set -euo pipefail
    threads="${RUST_TEST_THREADS:-$((2 * {{ num_cpus() }}))}"
    if cargo nextest --version > /dev/null 2>&1; then
        cargo nextest run --workspace --locked --no-run
        # Those in the documentation meanwhile: compilers take what the tests leave.
        said="$(mktemp)"
        cargo test --workspace --locked --doc --no-fail-fast > "$said" 2>&1 &
        documentation=$!
        failed=0
        cargo nextest run --workspace --locked --no-fail-fast --test-threads "$((5 * threads / 2))" || failed=1
        wait "$documentation" || failed=1
        cat "$said"
        rm "$said"
        exit "$failed"
    else
        RUST_TEST_THREADS="$threads" cargo test --workspace --locked
    fi

# Types of the Python client by pyright, which fetches Node.js
pyright:
    python3 -m venv target/python
    target/python/bin/pip install --quiet './python[test]' pyright
    target/python/bin/pyright --project python --pythonpath target/python/bin/python

# Every test there is, those that take minutes too, except measurements and those that need something that is not here
nightly: ci clippy-slim pyright
    FUZZ_SECONDS=10 cargo test --release --locked -p driftless-fuzz --test short_run
    cargo test --release --workspace --locked -- --ignored --skip load:: --skip latency --skip python --skip published --skip images::learned --skip object_store

# Every crate that is published could be
package:
    cargo package --workspace --locked --no-verify \
        --exclude driftless-tests --exclude driftless-testing --exclude driftless-benches --exclude driftless-fuzz

# The files of a release, in target/dist (needs cargo-zigbuild, cargo-deb, cargo-cyclonedx)
release *targets:
    deploy/release.sh {{ targets }}

# Installs the packages of target/dist in clean roots, and runs them (needs root, debootstrap, qemu-user-static)
check-release *architectures:
    deploy/check_release.sh {{ architectures }}

# Licences, advisories, sources (needs cargo-deny)
deny:
    cargo deny --locked check

# The book (needs mdbook)
book:
    mdbook build docs

# Timings of the estimator, the Schmidt update, the tracker and map queries
bench:
    cargo bench -p driftless-benches

# Kills each command so many times, at any time and in its last 50 ms, and has writers meet as often: the old state or the new one
# stays, and nothing else
kills count="200":
    KILLS={{ count }} cargo test --release --locked -p driftless-tools --test main -- --nocapture kills:: crossing::

# Loads a map server for so many seconds: a fleet with losses, a client of the costliest requests and a map that changes each minute; then
# each attack of hostile clients
soak seconds="1800":
    PROCESSORS=2 ROBOTS=100 LOSS=5 COSTLIEST=1 CHANGES=60 SECONDS={{ seconds }} cargo test --release --locked -p driftless-map-server --test main -- --ignored --nocapture load::fleet
    SECONDS=60 cargo test --release --locked -p driftless-map-server --test main -- --ignored --nocapture load::hostile::hostile_load

# Repeats the figures of the README and of the book
figures out="target/figures":
    cargo build --release --locked -p driftless-tools
    docs/figures.sh target/release "{{ data }}" "{{ out }}"

# Coverage-guided fuzzing of one target for some seconds (needs nightly and cargo-fuzz)
fuzz target seconds="60":
    cargo +nightly fuzz run --features libfuzzer "{{ target }}" -- -max_total_time={{ seconds }}
