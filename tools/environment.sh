# Makes or renews the virtual environment .venv/$environment from the pinned versions in tools/$environment.lock, and
# sets $venv. Sourced by the two commands, from the root of the repository. Needs Python 3.11 or newer.
#
# What a user has installed into .venv/run stays: a renewal installs over what is there, and an environment that cannot
# be renewed is moved aside. .venv/check is the project's own and made again, so that no old package hides a missing one.

find_python() {
    for candidate in "${PYTHON:-}" python3 python3.14 python3.13 python3.12 python3.11; do
        [ -n "$candidate" ] || continue
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            readlink -f "$(command -v "$candidate")" # that of an activated environment may be about to go
            return
        fi
    done
    echo "$0: no Python 3.11 or newer found; install one, or name it: PYTHON=/path/to/python3 $0" >&2
    return 1
}

# Debian splits venv off its Python
ensure_venv_module() {
    "$1" -c 'import ensurepip, venv' 2>/dev/null && return
    if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then
        echo "this Python has no venv module; installing Debian's python3-venv" >&2
        apt-get update -qq >/dev/null && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq python3-venv >/dev/null
        "$1" -c 'import ensurepip, venv' 2>/dev/null && return
    fi
    echo "$0: this Python has no venv module; please install it (Debian: sudo apt-get install python3-venv)" >&2
    return 1
}

# Shows which package pip is at, on a terminal in one line; $1: how many there are.
show_progress() {
    [ -t 2 ] && place='\r' end='\033[K' || place='' end='\n'
    awk -v total="$1" -v place="$place" -v end="$end" '
        function show(text) { printf "%s  %s%s", place, text, end > "/dev/stderr"; fflush("/dev/stderr") }
        /^Ignoring / { total -= 1 } # of another system or Python
        /^(Collecting|Processing|Requirement already satisfied:) / {
            name = $1 == "Requirement" ? $4 : $2
            sub(/.*\//, "", name)
            sub(/[=<>!~;\[].*|-[0-9].*/, "", name)
            seen += 1
            if (place != "" || seen % 10 == 1) show(seen " of " total " packages: " name)
        }
        /^Installing collected packages/ { show("installing") }
        END { if (place != "") printf "\r\033[K" > "/dev/stderr" }
    '
}

# Installs everything; the output is kept in $venv/set-up.log, and shown if a part fails.
install() {
    log=$venv/set-up.log
    # what is compiled is what is used, when it is: half of the time goes into the rest
    pip="$venv/bin/python -m pip install --disable-pip-version-check --no-input --no-compile --no-deps --retries 2"
    rm -f "$venv/pip-failed"
    for half in 0 1; do
        awk "/^[a-z0-9].*==/ { packages += 1 } packages % 2 == $half" "tools/$environment.lock" >"$venv/half-$half.lock"
    done
    # a pip works on one core, so two install half of the packages each; in the shell's background Ctrl-C would miss them
    # shellcheck disable=SC2086  one word for each option
    {
        printf '%s\n' 0 1 | xargs -P 2 -I '{}' $pip --require-hashes --only-binary :all: -r "$venv/half-{}.lock" 2>&1 &&
            $pip --no-build-isolation --no-index --editable . 2>&1 || : >"$venv/pip-failed"
    } | tee "$log" | show_progress "$(grep -c '^[a-z0-9].*==' "tools/$environment.lock")"
    [ -e "$venv/pip-failed" ] || return 0
    grep -v "^Collecting\|^  *Using cached\|^  *Downloading\|^Requirement already" "$log" | tail -n 15 >&2
    # pip tries again, then says that there is no such version
    if grep -q "Retrying\|[Cc]onnection\|resolve\|[Tt]imed out\|ProxyError" "$log"; then
        echo "$0: the packages could not be fetched: no package index answers. Is there a network, or a proxy to name" \
            "(HTTPS_PROXY)? What is fetched stays. Without a network: docs/how-to/install.md, Without a network" >&2
    fi
    return 1
}

# Moves an environment that cannot be renewed aside, as the user may have installed into it.
move_aside() {
    [ -e "$venv" ] || return 0
    if [ "$environment" = check ]; then
        rm -rf "$venv"
    else
        aside=$venv.before-$(date +%Y%m%d-%H%M%S)
        mv "$venv" "$aside" || return 1
        echo "$venv $1; it is now $aside: install again what you had put there, then remove it" >&2
    fi
}

venv=.venv/$environment
stamp=$venv/installed
wanted=$(cat "tools/$environment.lock" pyproject.toml tools/environment.sh | cksum; pwd)
if [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ] || ! "$venv/bin/python" -c '' 2>/dev/null; then
    python=$(find_python) || exit 1
    ensure_venv_module "$python" || exit 1
    if [ -e "$venv" ] && [ ! -O "$venv" ]; then
        echo "$0: $PWD/$venv belongs to somebody else and needs renewal: ask them to, or make a clone of your own" >&2
        exit 1
    fi
    if [ "$environment" = check ] || ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
        move_aside "has no Python that works any more" || exit 1
    elif [ "$(sed -n 2p "$stamp" 2>/dev/null)" != "$PWD" ] && [ -e "$stamp" ]; then
        move_aside "was made in another folder" || exit 1
    fi
    if [ -e "$venv" ]; then
        echo "renewing $venv; what you have installed there stays" >&2
    else
        echo "setting up $venv (once; later runs start at once)" >&2
        "$python" -m venv "$venv" || exit 1
    fi
    install || exit 1
    echo "$wanted" >"$stamp"
    [ "$environment" = check ] || echo "done: $venv/bin/inteco-abs is the command, and \`. $venv/bin/activate\` makes" \
        "it inteco-abs, as pages and messages call it" >&2
fi
