#!/usr/bin/env bash
# Set up what the inspector needs; where all of it is there already this does nothing, in a fraction of a second.
#
#     scripts/setup.sh serve    what `inspector` needs
#     scripts/setup.sh test     that, and what tests and development need
#
# Python packages go into .venv at the versions in constraints.txt, again when that file or pyproject.toml has changed.
# Missing system packages are installed by apt where that takes no password; else one line names them.
# The variable PYTHON chooses the interpreter that .venv is made with.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

purpose=${1:-serve}
case $purpose in
    serve) distribution=. ;;
    test) distribution='.[test,synth,distributed]' ;;
    *) echo "setup: unknown purpose '$purpose'; take serve or test" >&2; exit 2 ;;
esac

say() { echo "setup: $*" >&2; }

# ---- system packages

packages=()
need() { # need PACKAGE TEST...: note the package unless the test succeeds
    local package=$1
    shift
    "$@" || packages+=("$package")
}

libraries=$(PATH=$PATH:/usr/sbin:/sbin ldconfig -p 2>/dev/null || true)
has_library() { [[ $libraries == *"$1"* ]]; }
has_any_command() { command -v "$@" >/dev/null; }
has_gl_driver() { has_library libEGL_nvidia.so || compgen -G '/usr/lib/*/dri/*_dri.so' >/dev/null; }
has_font() { [[ -n $(find /usr/share/fonts /usr/local/share/fonts -name '*.[ot]tf' -print -quit 2>/dev/null) ]]; }

install_packages() { # by apt, all at once; fails where that is not possible
    local administrator=() options=(-qq -o DPkg::Lock::Timeout=300 -o Acquire::http::Timeout=30)
    has_any_command apt-get || return 1
    if ((EUID)); then
        sudo -n true 2>/dev/null || return 1
        administrator=(sudo -n)
    fi
    say "installing $*"
    "${administrator[@]}" apt-get "${options[@]}" update </dev/null >/dev/null 2>&1 || true # an old list may do
    "${administrator[@]}" env DEBIAN_FRONTEND=noninteractive \
        apt-get "${options[@]}" install --yes --no-install-recommends "$@" </dev/null >/dev/null 2>&1
}

install_needed() { # install_needed WHAT_FOR: all that was noted, or one line that says what to do
    if ((${#packages[@]})) && ! install_packages "${packages[@]}"; then
        say "$1 needs system packages that are not here; install them: sudo apt-get install ${packages[*]}"
    fi
    packages=()
}

need libusb-1.0-0 has_library libusb-1.0.so.0 # open3d, as the next three
need libx11-6 has_library libX11.so.6
need libgl1 has_library libGL.so.1
need libegl1 has_library libEGL.so.1
need libegl-mesa0 has_library libEGL_ # pyrender: a driver behind libEGL
need libgles2 has_library libGLESv2.so.2
need libgl1-mesa-dri has_gl_driver
need libgomp1 has_library libgomp.so.1
install_needed "drawing"

if [[ $purpose == test ]]; then
    chromium=chromium
    if grep -qs '^ID=ubuntu' /etc/os-release; then chromium='chromium-browser'; fi
    need "$chromium" has_any_command chromium chromium-browser google-chrome
    need fonts-dejavu-core has_font
    need libatomic1 has_library libatomic.so.1 # playwright
    install_needed "testing in a browser"
    # Path tracing is several times as fast with a recent LLVM, and works without.
    has_recent_llvm() { [[ $libraries =~ libLLVM(\.so\.|-)(19|2[0-9]) ]]; }
    if ! has_recent_llvm && has_any_command apt-cache && [[ -n $(apt-cache madison libllvm19 2>/dev/null) ]]; then
        install_packages libllvm19 || say "path tracing is faster with libllvm19: sudo apt-get install libllvm19"
    fi
fi

# ---- Python packages

find_python() { # print the first interpreter that is new enough
    local candidate
    for candidate in ${PYTHON:-python3 python3.14 python3.13 python3.12 python3.11}; do
        if "$candidate" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            echo "$candidate"
            return
        fi
    done
    return 1
}

make_venv() {
    local python
    if ! python=$(find_python) && [[ -z ${PYTHON:-} ]]; then
        packages=(python3 python3-venv)
        install_needed "the inspector"
    fi
    if ! python=$(find_python); then
        say "${PYTHON:-python3} is not Python 3.11 or newer; name one that is: make setup PYTHON=/path/to/python3"
        exit 1
    fi
    need "$(basename "$python")-venv" "$python" -c 'import ensurepip, venv' 2>/dev/null # a package of its own in Debian
    install_needed "making .venv"
    say "making .venv with $("$python" --version)"
    "$python" -m venv --clear .venv
}

sum_of() { sha256sum | cut -d ' ' -f 1; }
stamped() { [[ -f $1 && $(<"$1") == "$2" ]]; }

# An editable installation points at this folder, so that a moved tree is set up anew.
wanted=$({ pwd && cat pyproject.toml constraints.txt; } | sum_of)
stamp=.venv/.installed-for
if ! .venv/bin/python -c 'import pip' 2>/dev/null; then make_venv; fi
if ! stamped "$stamp-$purpose" "$wanted"; then
    say "installing Python packages (minutes, the first time)"
    .venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e "$distribution"
    echo "$wanted" >"$stamp-serve"
    if [[ $purpose == test ]]; then echo "$wanted" >"$stamp-test"; fi
fi

# ---- compiled loops, so that the first page does not wait for the compiler

sources=$({ echo "$wanted" && grep -rl --include='*.py' numba pipeline | sort | xargs cat; } | sum_of)
stamp=.venv/.compiled-$purpose
if ! stamped "$stamp" "$sources"; then
    say "compiling the inner loops"
    fitting=()
    if [[ $purpose == test ]]; then fitting=(--fitting); fi
    .venv/bin/python -m pipeline.warm_up "${fitting[@]}"
    echo "$sources" >"$stamp"
fi
