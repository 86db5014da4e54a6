#!/usr/bin/env bash
# Installs the Debian packages of target/dist in clean roots of the oldest Debian that they are for, and runs them. `just check-release`
# calls it; it needs root, debootstrap and, for arm64 on another machine, qemu-user-static.
#
#   deploy/check_release.sh [ARCHITECTURE ...]     amd64 and arm64, if none is given
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

# With glibc 2.31.
DEBIAN=bullseye
architectures=("$@")
if [ ${#architectures[@]} -eq 0 ]; then
    architectures=(amd64 arm64)
fi
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT

for architecture in "${architectures[@]}"; do
    root="$work/$architecture"
    debootstrap --variant=minbase --arch="$architecture" "$DEBIAN" "$root" > "$work/debootstrap.log" 2>&1 \
        || { tail -n 20 "$work/debootstrap.log"; exit 1; }
    cp target/dist/*_"$architecture".deb "$root/tmp/"
    chroot "$root" /bin/sh -ec '
        cd /tmp
        dpkg --install ./*.deb > /dev/null
        for program in driftless map_server onboard; do $program --version; done
        test -s /usr/share/man/man1/driftless-build-map.1.gz
        test -s /usr/lib/systemd/system/driftless-map-server.service
        test -s /etc/driftless/map_server.conf
        driftless simulate --out place > /dev/null
        driftless build-map place/map --map place.db --gravity 0,0,-1 > /dev/null
        driftless run place/live --map place.db --out out
    '
    cp "$root/tmp/out/states.csv" "$work/$architecture.csv"
    echo "$architecture: installed, and ran"
done

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
