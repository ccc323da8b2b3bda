# Makes or renews the virtual environment .venv/$environment from the pinned versions in tools/$environment.lock, and
# sets $venv. Sourced by the two commands, from the root of the repository. Needs Python 3.11 or newer.

find_python() {
    for candidate in "${PYTHON:-}" python3 python3.14 python3.13 python3.12 python3.11; do
        [ -n "$candidate" ] || continue
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            command -v "$candidate"
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

venv=.venv/$environment
stamp=$venv/installed
wanted=$(cat "tools/$environment.lock" pyproject.toml tools/environment.sh | cksum; pwd)
if [ "$(cat "$stamp" 2>/dev/null)" != "$wanted" ] || ! "$venv/bin/python" -c '' 2>/dev/null; then
    python=$(find_python) || exit 1
    echo "setting up $venv (once; later runs start at once)" >&2
    ensure_venv_module "$python" || exit 1
    if [ -e "$venv" ] && [ ! -O "$venv" ]; then
        echo "$0: $PWD/$venv belongs to somebody else and needs renewal: ask them to, or make a clone of your own" >&2
        exit 1
    fi
    rm -rf "$venv"
    "$python" -m venv "$venv" || exit 1
    # what is compiled is what is used, when it is: half of the time goes into the rest
    pip="$venv/bin/python -m pip install -qq --disable-pip-version-check --no-input --no-compile"
    $pip --require-hashes --only-binary :all: -r "tools/$environment.lock" >&2 || exit 1
    $pip --no-deps --no-build-isolation --no-index --editable . >&2 || exit 1
    echo "$wanted" >"$stamp"
fi
