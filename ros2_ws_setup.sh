#!/usr/bin/env bash
# Sets up, demonstrates, tests and builds track_before_detect; see --help.

set -euo pipefail

package_dir=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")" && pwd -P)
script_path=$package_dir/ros2_ws_setup.sh
venv=$package_dir/.venv
venv_python=$venv/bin/python
owner_file=$venv/.made_by_ros2_ws_setup
stamp_file=$venv/.setup_complete
compiled_file=$venv/.loops_compiled
log_file=$venv/setup.log
ros_root=/opt/ros/jazzy
needed_mb=1500
lowest_minor=10
highest_minor=13
child=
step=0
steps=0

usage() {
    cat <<'HELP'
Usage: ros2_ws_setup.sh [COMMAND] [ARGUMENTS]

Commands:
  setup             make everything ready (the default); quick when nothing has changed
  demo [INPUT]      set up, then play a recording to the detector over DDS and show what it finds:
                    INPUT is a .npz file, a folder of images, a multi-page TIFF, a FITS cube,
                    a video or a rosbag2; without INPUT a recording is simulated on the spot.
                    Options: demo --help
  test [ARGS]       set up, then run the test suite; ARGS go to pytest, e.g. test -k batcher
  build [ARGS]      set up, then build with colcon; ARGS go to colcon build
  docs              set up, then build the documentation site into build/docs/html
  --help            show this text

With ROS 2 Jazzy in /opt/ros/jazzy that installation is used; otherwise its wheels from PyPI (Linux on
x86_64). Either way Python packages go to the folder .venv beside this script and nowhere else:
.venv/bin/tbd and .venv/bin/python work after set-up.

Environment:
  TBD_PYTHON        the Python to use, 3.10 to 3.13 (found by itself when not set)
  TBD_DATA_DIR      folder with real recordings for the tests that need them
  ROS_DOMAIN_ID     DDS domain of demo and test (a free one when not set)

Exit codes: 0 done, or demo ended by Ctrl-C, 1 set-up failed (one sentence says why), 2 wrong usage or
bad input, 3 demo ran and found nothing, 130 set-up interrupted; test, build and docs end with the code
of pytest, colcon, Sphinx.
HELP
}

say() { printf '%s\n' "$*"; }

fail() {
    printf 'ros2_ws_setup: error: %s\n' "$*" >&2
    exit 1
}

interrupted() {
    trap '' INT TERM HUP
    if [[ -n $child ]]; then
        kill -TERM -- "-$child" 2>/dev/null || true
        wait "$child" 2>/dev/null || true
    fi
    printf '\nros2_ws_setup: interrupted; run it again to go on\n' >&2
    exit 130
}

free_mb() { df -Pk -- "$1" 2>/dev/null | awk 'NR == 2 { print int($4 / 1024) }'; }

disk_full() {
    local temporary=${TMPDIR:-/tmp}
    fail "the disk is full: $(free_mb "$package_dir") MB are free in $package_dir and" \
        "$(free_mb "$temporary") MB in $temporary, and set-up needs about $needed_mb MB"
}

# What a command wrote to the log tells a person more when it is put as one sentence.
explain_failure() {
    local title=$1 code=$2 output=$3 missing
    printf '\n' >&2
    tail -n 12 <<<"$output" | cut -c 1-160 | sed 's/^/    /' >&2
    if grep -qE 'No space left on device|Disk quota exceeded' <<<"$output"; then
        disk_full
    fi
    if grep -qE 'NewConnectionError|Connection refused|name resolution|Max retries exceeded|timed out|ProxyError|SSLError|Network is unreachable|ConnectionResetError|(50[0234]|403) (Server|Client) Error' <<<"$output"; then
        fail "$title failed because the Python package registry cannot be reached: check the" \
            "network and pip's configuration and run this again (log: $log_file)"
    fi
    missing=$(sed -n 's/^ERROR: No matching distribution found for \(.*\)$/\1/p' <<<"$output" \
        | head -n 1)
    if [[ -n $missing ]]; then
        fail "$title failed because the Python package registry has no $missing for" \
            "$("$venv_python" --version) on $(uname -sm) (log: $log_file)"
    fi
    fail "$title failed with exit code $code (log: $log_file)"
}

# run_step TITLE COMMAND...: runs the command with its output in the log and shows how long it takes.
run_step() {
    local title=$1 began=$SECONDS shown=0 waited code=0 log_start doing
    shift
    step=$((step + 1))
    local head="[$step/$steps] $title"
    { printf '\n===== %s\n' "$head" >>"$log_file"; } 2>/dev/null || disk_full
    log_start=$(wc -c <"$log_file")
    [[ -t 1 ]] || say "$head ..."
    # The lock must end with this script, not with a process that outlives it.
    # Job control gives it a process group, so that an interrupt ends what it started as well.
    set -m
    "$@" >>"$log_file" 2>&1 </dev/null 9>&- &
    child=$!
    set +m
    while kill -0 "$child" 2>/dev/null; do
        waited=$((SECONDS - began))
        if [[ -t 1 ]]; then
            doing=$(tail -n 1 -- "$log_file" | tr -d '\r' | cut -c 1-40)
            printf '\r\033[K%s: %d s  %s' "$head" "$waited" "$doing"
        elif ((waited - shown >= 20)); then
            shown=$waited
            say "$head: $waited s so far ($(tail -n 1 -- "$log_file" | tr -d '\r' | cut -c 1-60))"
        fi
        sleep 0.2
    done
    wait "$child" || code=$?
    child=
    [[ ! -t 1 ]] || printf '\r\033[K'
    if ((code != 0)); then
        say "$head: failed after $((SECONDS - began)) s"
        explain_failure "$title" "$code" "$(tail -c "+$((log_start + 1))" -- "$log_file")"
    fi
    say "$head: done in $((SECONDS - began)) s"
}

# Prints "MAJOR.MINOR MACHINE VENV" of a Python, where VENV is yes or no; fails when it does not run.
# A command of the right name may be a launcher that only says which versions it could offer.
probe_python() {
    "$1" -I -c '
import importlib.util, platform, sys
found = all(importlib.util.find_spec(name) for name in ("venv", "ensurepip"))
print("%d.%d" % sys.version_info[:2], platform.machine(), "yes" if found else "no")
' 2>/dev/null
}

supported_version() {
    local minor=${1#3.}
    [[ $1 == 3.* && $minor =~ ^[0-9]+$ ]] && ((minor >= lowest_minor && minor <= highest_minor))
}

# Sets `python` to a usable interpreter.
find_python() {
    local candidates candidate version machine has_venv unsuited='' lacking=''
    if [[ -n ${TBD_PYTHON:-} ]]; then
        candidates=("$TBD_PYTHON")
    elif [[ $mode == installed ]]; then
        # rclpy of an apt installation is compiled for the system's own Python.
        candidates=(/usr/bin/python3)
    else
        candidates=(python3.12 python3.11 python3.13 python3.10 python3 python
            /usr/bin/python3 "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.1[0-3].*/bin/python)
    fi
    for candidate in "${candidates[@]}"; do
        candidate=$(command -v -- "$candidate") || continue
        read -r version machine has_venv < <(probe_python "$candidate") || continue
        if ! supported_version "$version"; then
            unsuited="$version ($candidate)"
        elif [[ $has_venv != yes ]]; then
            lacking="$version ($candidate)"
        else
            check_machine "$machine"
            python=$candidate
            return
        fi
    done
    if [[ -n $lacking ]]; then
        fail "Python $lacking lacks the venv or the ensurepip module: install it (on Debian and" \
            "Ubuntu the package python${lacking%% *}-venv) and run this again"
    elif [[ -n $unsuited ]]; then
        fail "Python 3.$lowest_minor to 3.$highest_minor is needed and only Python $unsuited was" \
            "found: install one, or name it in TBD_PYTHON"
    elif [[ -n ${TBD_PYTHON:-} ]]; then
        fail "TBD_PYTHON names $TBD_PYTHON, which does not run"
    else
        fail "Python 3.$lowest_minor to 3.$highest_minor is needed and no Python was found:" \
            "install one, or name it in TBD_PYTHON"
    fi
}

check_machine() {
    [[ $mode == wheels ]] || return 0
    if [[ $(uname -s) != Linux || $1 != x86_64 ]]; then
        fail "the wheels of ROS 2 Jazzy on PyPI are for Linux on x86_64 and this is" \
            "$(uname -s) on $1: install ROS 2 Jazzy in $ros_root and run this again"
    fi
}

# Sets `mode` and prepares the environment that every later command runs in.
prepare_environment() {
    # An inherited guard would keep the wheels from setting their library path.
    unset _ROS_WHEELS_BOOTSTRAP_COMPLETE PYTHONHOME
    export PIP_USER=0 PIP_DISABLE_PIP_VERSION_CHECK=1
    if [[ -f $ros_root/setup.bash ]]; then
        mode=installed
        set +u
        # shellcheck disable=SC1091
        source "$ros_root/setup.bash"
        set -u
    else
        mode=wheels
        # Packages of another ROS distribution must not mix with the wheels.
        unset PYTHONPATH ROS_DISTRO AMENT_PREFIX_PATH
    fi
}

fingerprint() {
    {
        printf '%s\n' "$package_dir" "$mode" "${TBD_PYTHON:-}"
        cat -- "$script_path" "$package_dir/setup.py" "$package_dir/setup.cfg" \
            "$package_dir/pyproject.toml"
    } | sha256sum | cut -d ' ' -f 1
}

is_complete() {
    [[ -x $venv_python && -x $venv/bin/tbd && -f $stamp_file ]] \
        && [[ $(<"$stamp_file") == "$(fingerprint)" ]]
}

# An environment is kept when it runs, has pip and is of the Python asked for.
venv_is_usable() {
    local version wanted
    [[ -x $venv_python ]] || return 1
    read -r version _ < <(probe_python "$venv_python") || return 1
    read -r wanted _ < <(probe_python "$python") || return 1
    if [[ -n ${TBD_PYTHON:-} ]]; then
        [[ $version == "$wanted" ]] || return 1
    fi
    supported_version "$version" || return 1
    # Scripts hold the path of the folder they were made in.
    grep -qF -- "$venv" "$venv/bin/activate" 2>/dev/null || return 1
    [[ $("$venv_python" -c 'import os, sys; print(os.path.realpath(sys.prefix))') == "$venv" ]] \
        || return 1
    if [[ $mode == installed ]]; then
        grep -q 'include-system-site-packages = true' "$venv/pyvenv.cfg" || return 1
    else
        grep -q 'include-system-site-packages = false' "$venv/pyvenv.cfg" || return 1
    fi
    "$venv_python" -m pip --version >/dev/null 2>&1
}

make_venv() {
    local options=()
    find "$venv" -mindepth 1 -maxdepth 1 ! -name "$(basename -- "$log_file")" ! -name .lock \
        ! -name "$(basename -- "$owner_file")" -exec rm -rf -- {} +
    [[ $mode != installed ]] || options+=(--system-site-packages)
    "$python" -m venv "${options[@]}" "$venv"
}

pip_install() {
    "$venv_python" -m pip install --no-input --progress-bar off --retries 3 "$@"
}

install_package() {
    local options=()
    if [[ $mode == installed ]]; then
        # Another numpy would not fit the scipy and the rclpy that the system's numpy serves.
        "$venv_python" - >"$venv/constraints.txt" <<'PYTHON'
from importlib.metadata import PackageNotFoundError, version

for name in ('numpy', 'scipy'):
    try:
        print(f'{name}=={version(name)}')
    except PackageNotFoundError:
        pass
PYTHON
        options+=(--constraint "$venv/constraints.txt")
    fi
    # setuptools 80 dropped what colcon build --symlink-install calls.
    pip_install 'setuptools>=70.1,<80'
    cd -- "$package_dir"
    pip_install "${options[@]}" --no-build-isolation --editable '.[readers,recorder,video,plots,cli,completion,parallel,test]'
}

check_installation() {
    "$venv_python" -c '
import diagnostic_msgs.msg, nav_msgs.msg, rclpy, sensor_msgs.msg, visualization_msgs.msg
import track_before_detect
print("track_before_detect", track_before_detect.__version__)'
}

compile_ahead() {
    local stamp
    stamp=$(cd -- "$package_dir/src" && find . -name '*.py' -path '*/kernels/*' -print0 | sort -z \
        | xargs -0 sha256sum | sha256sum)
    if [[ ! -f $compiled_file || $(<"$compiled_file") != "$stamp" ]]; then
        run_step 'compiling the loops' "$venv/bin/tbd" warm-up
        printf '%s\n' "$stamp" >"$compiled_file"
    fi
}

setup() {
    local began=$SECONDS python='' free made=no source_of_ros
    command -v sha256sum >/dev/null || fail "the command sha256sum (coreutils) is missing"
    prepare_environment
    if is_complete; then
        trap interrupted INT TERM HUP
        steps=1
        compile_ahead
        trap - INT TERM HUP
        return
    fi
    find_python
    if [[ -e $venv && ! -f $owner_file ]] && [[ -n $(ls -A -- "$venv" 2>/dev/null) ]]; then
        fail "$venv was not made by this script: move it away or delete it and run this again"
    fi
    mkdir -p -- "$venv" 2>/dev/null || fail "$venv cannot be made: is the folder writable?"
    { : >"$owner_file" && : >"$venv/.lock"; } 2>/dev/null \
        || fail "$venv cannot be written: is it writable, and is the disk full?"
    exec 9>"$venv/.lock"
    if command -v flock >/dev/null && ! flock -n 9; then
        say "another set-up of this folder is running; waiting for it"
        flock 9
        if is_complete; then
            exec 9>&-
            return
        fi
    fi
    rm -f -- "$stamp_file"
    : >"$log_file"
    trap interrupted INT TERM HUP
    if [[ $mode == wheels ]]; then
        steps=6
        source_of_ros=PyPI
    else
        steps=5
        source_of_ros=$ros_root
    fi
    say "setting up track_before_detect in $venv ($("$python" --version), ROS 2 Jazzy from" \
        "$source_of_ros)"
    if venv_is_usable; then
        steps=$((steps - 1))
    else
        free=$(free_mb "$venv")
        ((free >= needed_mb)) || disk_full
        made=yes
    fi
    [[ $made == no ]] || run_step 'making the virtual environment' make_venv
    if [[ $mode == wheels ]]; then
        run_step 'installing ROS 2 Jazzy' pip_install \
            ros-jazzy-rclpy ros-jazzy-common-interfaces ros-jazzy-rmw-fastrtps-cpp
    fi
    run_step 'installing track_before_detect and what it needs' install_package
    run_step 'installing colcon' pip_install colcon-common-extensions 'setuptools>=70.1,<80'
    run_step 'checking the installation' check_installation

    fingerprint >"$stamp_file.new"
    mv -- "$stamp_file.new" "$stamp_file"
    rm -f -- "$compiled_file"
    compile_ahead
    trap - INT TERM HUP
    exec 9>&-
    say "set-up complete in $((SECONDS - began)) s"
}

# Keeps what we start from hearing, and being heard by, anything else.
isolate_dds() {
    export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
    if [[ -z ${ROS_DOMAIN_ID:-} ]]; then
        ROS_DOMAIN_ID=$("$venv_python" -m track_before_detect.ros.domain)
        export ROS_DOMAIN_ID
    fi
}

build_docs() {
    local site=$package_dir/build/docs/html
    cd -- "$package_dir"
    if ! "$venv_python" -c 'import myst_parser, sphinx, sphinx_copybutton, sphinx_design
import latex2mathml, matplotlib, pydata_sphinx_theme, sphinx_gallery' 2>/dev/null; then
        steps=$((step + 1))
        run_step 'installing what builds the documentation' \
            pip_install --no-build-isolation --editable '.[docs]'
    fi
    "$venv_python" -m sphinx --fresh-env --fail-on-warning --keep-going --nitpicky --quiet \
        -d build/docs/doctrees -c docs . "$site" "$@"
    say "open file://$site/index.html"
}

main() {
    local command=${1:-setup}
    (($# == 0)) || shift
    case $command in
        setup)
            if (($# > 0)); then
                printf 'ros2_ws_setup: error: setup takes no arguments, got: %s\n' "$*" >&2
                exit 2
            fi
            setup
            say "ready: $venv/bin/tbd --help, $script_path demo, $script_path test"
            ;;
        demo)
            setup
            isolate_dds
            exec "$venv_python" -m track_before_detect.ros.demo "$@"
            ;;
        test)
            setup
            isolate_dds
            cd -- "$package_dir"
            # Without bytecode every node that a test starts would compile the package's modules.
            unset PYTHONDONTWRITEBYTECODE
            # How many "auto" means is said in test/conftest.py; with --pdb, which cannot reach
            # others, it is this process alone.
            exec "$venv_python" -m pytest --numprocesses auto --dist loadfile "$@"
            ;;
        build)
            setup
            cd -- "$package_dir"
            if [[ $package_dir == *[[:space:]]* ]]; then
                fail "colcon's scripts do not work in a folder whose path holds spaces:" \
                    "$package_dir"
            fi
            # Found as a module, colcon gives the executables this environment's Python, wherever
            # colcon itself was installed.
            exec "$venv_python" -c 'import sys; from colcon_core.command import main; sys.exit(main())' \
                build "$@"
            ;;
        docs)
            setup
            build_docs "$@"
            ;;
        -h | --help | help)
            usage
            ;;
        *)
            printf 'ros2_ws_setup: error: unknown command %s; known: setup, demo, test, build, docs, --help\n' \
                "$command" >&2
            exit 2
            ;;
    esac
}

main "$@"
