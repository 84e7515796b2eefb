#!/usr/bin/env bash
# Installs the Debian packages whose libraries open3d, Mitsuba and EGL rendering load, where that is allowed; prints the
# one command otherwise. Never fails: what needs a missing library says so itself, and the rest works without it.
set -u
declare -A package=(
    [libusb-1.0.so.0]=libusb-1.0-0
    [libgomp.so.1]=libgomp1
    [libatomic.so.1]=libatomic1
    [libudev.so.1]=libudev1
    [libidn2.so.0]=libidn2-0
    [libX11.so.6]=libx11-6
    [libGL.so.1]=libgl1
    [libEGL.so.1]=libegl1
)
[ "$(uname -s)" = Linux ] || exit 0
known=$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null)
missing=()
for library in "${!package[@]}"; do
    grep -q "$library " <<<"$known" || missing+=("${package[$library]}")
done
[ ${#missing[@]} -gt 0 ] || exit 0

install="apt-get install -y --no-install-recommends ${missing[*]}"
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "installing ${missing[*]}"
    export DEBIAN_FRONTEND=noninteractive
    log=$(mktemp)
    { apt-get update -qq && $install -qq; } >"$log" 2>&1 && rm "$log" && exit 0
    tail -n 3 "$log" >&2
    rm "$log"
fi
echo "note: system libraries are missing; open3d and EGL pictures need them, the rest goes on. On Debian or Ubuntu:" >&2
echo "  sudo apt-get update && sudo $install" >&2
