#!/bin/sh
# Make offscreen rendering work: the demo's video needs it, nothing else does.
# Usage: offscreen.sh PYTHON. Never fails: without it the demo goes on without a video.
python=$1

renders() {
	MUJOCO_GL=osmesa "$python" -c '
import mujoco
mujoco.GLContext(16, 16).free()' >/dev/null 2>&1
}

install_library() {
	case $(id -u) in
	0) root= ;;
	*) sudo -n true 2>/dev/null && root="sudo -n" || return 1 ;;
	esac
	command -v apt-get >/dev/null || return 1
	$root apt-get update -qq && $root apt-get install -y -qq libosmesa6
}

renders && exit 0
echo "offscreen rendering needs the library libOSMesa.so.8; trying to install it"
install_library >/dev/null 2>&1
renders && exit 0
cat <<'TEXT'
Missing: libOSMesa.so.8. Everything runs without it, but the demo makes no video.
Install it yourself, for example:  sudo apt-get install libosmesa6
TEXT
exit 0
