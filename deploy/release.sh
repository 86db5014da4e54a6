#!/usr/bin/env bash
# Builds the files of a release in target/dist: archives of the programs, Debian packages, the Python wheel, a bill of materials and
# checksums. `just release` calls it; it needs cargo-zigbuild, cargo-deb, cargo-cyclonedx and python3 with pip. Where DRIFTLESS_SIGNING_KEY names
# a secret key of minisign without a password, the checksums are signed with it.
#
#   deploy/release.sh [TARGET ...]     x86_64-unknown-linux-gnu and aarch64-unknown-linux-gnu, if none is given
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# The oldest C library that the programs run with: Debian 11, Ubuntu 20.04.
GLIBC=2.31
PACKAGES=(driftless-tools driftless-map-server driftless-onboard)
PROGRAMS=(driftless map_server onboard)

targets=("$@")
if [ ${#targets[@]} -eq 0 ]; then
    targets=(x86_64-unknown-linux-gnu aarch64-unknown-linux-gnu)
fi
version="$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)"
target_dir="${CARGO_TARGET_DIR:-target}"
dist="$PWD/target/dist"
manual="$PWD/target/manual"
rm -rf "$dist" "$manual"
mkdir -p "$dist"

build() { # TARGET
    cargo zigbuild --release --locked --target "$1.$GLIBC" "${PACKAGES[@]/#/--package=}"
}

# Man pages and completions are the same everywhere, and are written by a program for this machine.
here="$(rustc --print host-tuple)"
build "$here"
"$target_dir/$here/release/driftless" manual --out "$manual"

for target in "${targets[@]}"; do
    build "$target"
    name="driftless-$version-$target"
    tree="$(mktemp -d)"
    mkdir -p "$tree/$name/bin"
    cp "${PROGRAMS[@]/#/$target_dir/$target/release/}" "$tree/$name/bin/"
    cp -r "$manual" "$tree/$name/share"
    cp -r deploy/systemd "$tree/$name/share/systemd"
    cp README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE "$tree/$name/"
    tar -C "$tree" --owner=0 --group=0 --sort=name -cJf "$dist/$name.tar.xz" "$name"
    rm -rf "$tree"
    for package in "${PACKAGES[@]}"; do
        cargo deb --locked --no-build --no-strip --package "$package" --target "$target" --output "$dist"
    done
done

python3 -m pip wheel --quiet --no-deps --wheel-dir "$dist" ./python
cargo cyclonedx --quiet --format json --target all --manifest-path tools/Cargo.toml --override-filename driftless.cdx
mv tools/driftless.cdx.json "$dist/driftless-$version.cdx.json"
find . -path ./target -prune -o -name driftless.cdx.json -exec rm {} +

(cd "$dist" && sha256sum -- * > SHA256SUMS)
if [ -n "${DRIFTLESS_SIGNING_KEY:-}" ]; then
    minisign -Sm "$dist/SHA256SUMS" -s "$DRIFTLESS_SIGNING_KEY" -t "driftless $version" < /dev/null
fi
ls -l "$dist"
