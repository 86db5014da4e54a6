#!/usr/bin/env bash
# Checks the files of a release in target/dist: checksums, signature, sizes and bill of materials; installs the Debian packages in clean
# roots of the oldest Debian that they are for, and runs them; installs the wheel, and checks types with it. `just check-release` calls it; it
# needs root, debootstrap, minisign where the release is signed (DRIFTLESS_RELEASE_KEY names the public key), and for arm64 on another machine
# qemu-user-static, registered with the kernel.
#
#   deploy/check_release.sh [ARCHITECTURE ...]     amd64 and arm64, if none is given
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# With glibc 2.31.
DEBIAN=bullseye
# What a robot, a server and a workstation download at most, bytes; and all three programs without packages.
declare -A LARGEST=([driftless-onboard]=25000000 [driftless-map-server]=25000000 [driftless]=40000000 [archive]=40000000)
# From the downloaded package to the picture of the demo, seconds, on two processors.
DEMO_S=120

architectures=("$@")
if [ ${#architectures[@]} -eq 0 ]; then
    architectures=(amd64 arm64)
fi
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT

check_files() {
    (cd target/dist && sha256sum --quiet --check SHA256SUMS)
    if [ -e target/dist/SHA256SUMS.minisig ]; then
        minisign -Vqm target/dist/SHA256SUMS -p "${DRIFTLESS_RELEASE_KEY:?names the file of the public key}"
        echo "checksums: valid, and signed"
    else
        echo "checksums: valid, not signed (DRIFTLESS_SIGNING_KEY was not given to just release)"
    fi
    local file name size
    for file in target/dist/*.deb target/dist/*.tar.xz; do
        name="$(basename "$file")"
        size="$(stat --format %s "$file")"
        case "$name" in
            *.tar.xz) name=archive ;;
            *) name="${name%%_*}" ;;
        esac
        printf '%s: %d.%d MB, at most %d\n' "$(basename "$file")" $((size / 1000000)) $((size / 100000 % 10)) $((LARGEST[$name] / 1000000))
        [ "$size" -le "${LARGEST[$name]}" ]
    done
    python3 - target/dist/*.cdx.json << 'END'
import json, sys
bill = json.load(open(sys.argv[1]))
components = bill["components"]
unnamed = [one["name"] for one in components if not one.get("licenses") or not one.get("purl")]
assert bill["bomFormat"] == "CycloneDX" and len(components) > 200, len(components)
assert any(one["name"] == "zenoh" for one in components)
print(f"bill of materials: {len(components)} components, {len(unnamed)} of them without licence or address {unnamed[:5]}")
END
}

check_packages() { # ARCHITECTURE
    local root="$work/$1"
    debootstrap --variant=minbase --arch="$1" "$DEBIAN" "$root" > "$work/debootstrap.log" 2>&1 \
        || { tail -n 20 "$work/debootstrap.log"; exit 1; }
    cp target/dist/*_"$1".deb "$root/tmp/"
    chroot "$root" /bin/sh -ec '
        cd /tmp
        dpkg --install ./*.deb > /dev/null
        for program in driftless map_server onboard; do $program --version; done
        test -s /usr/share/man/man1/driftless-build-map.1.gz
        test -s /usr/lib/systemd/system/driftless-map-server.service
        test -s /usr/lib/systemd/system/driftless-maintain.timer
        test -s /etc/driftless/map_server.conf
        test -s /etc/driftless/maintain.conf
        driftless simulate --out place > /dev/null
        driftless build-map place/map --map place.db --gravity 0,0,-1 > /dev/null
        driftless run place/live --map place.db --out out
    '
    cp "$root/tmp/out/states.csv" "$work/$1.csv"
    echo "$1: installed, and ran"
}

# What a newcomer does after the download: an installation and the demo.
check_demo() {
    local root="$work/amd64" begin end
    chroot "$root" dpkg --purge driftless driftless-map-server driftless-onboard > /dev/null
    begin="$(date +%s%N)"
    chroot "$root" /bin/sh -ec 'cd /tmp && dpkg --install ./driftless_*.deb > /dev/null && driftless demo --out demo'
    end="$(date +%s%N)"
    test -s "$root/tmp/demo/comparison.svg"
    printf 'from the package to the picture of the demo: %d s of wall time, at most %d\n' $(((end - begin) / 1000000000)) "$DEMO_S"
    [ $(((end - begin) / 1000000000)) -lt "$DEMO_S" ]
}

# The wheel in an environment of its own, where nothing but it can be found.
check_wheel() {
    python3 -m venv "$work/venv"
    local wheel
    wheel="$(realpath target/dist/*.whl)"
    "$work/venv/bin/pip" install --quiet "${wheel}[plot]" mypy pyright
    cat > "$work/typed.py" << 'END'
import driftless


def state(status: driftless.RobotStatus) -> str:
    return status.state
END
    (
        cd "$work"
        export PATH="$work/venv/bin:$PATH"
        mypy --strict typed.py
        mypy --strict -p driftless
        pyright --pythonpath "$work/venv/bin/python" typed.py
        pyright --pythonpath "$work/venv/bin/python" --ignoreexternal --verifytypes driftless | grep 'Type completeness score: 100%'
    )
    echo "wheel: installed, and typed"
}

check_files
for architecture in "${architectures[@]}"; do
    check_packages "$architecture"
done
if [ -d "$work/amd64" ]; then
    check_demo
fi
check_wheel

if [ -f "$work/amd64.csv" ] && [ -f "$work/arm64.csv" ]; then
    # Numbers of both runs, line by line.
    paste -d '\n' "$work/amd64.csv" "$work/arm64.csv" | awk -F, '
        NR % 2 { count = NF; for (k = 1; k <= NF; k++) first[k] = $k; next }
        NF != count { print "line " NR / 2 ": other fields"; exit 1 }
        { for (k = 1; k <= NF; k++) if ($k != first[k]) {
            difference = ($k - first[k]) / (1 + ($k < 0 ? -$k : $k)); if (difference < 0) difference = -difference
            if (difference > largest) largest = difference } }
        END { printf "largest relative difference between amd64 and arm64: %.1e\n", largest; exit !(largest <= 1e-9) }'
fi
