#!/usr/bin/env bash
# The machine of the system tests: image.sh OUT WHEEL WHEELHOUSE MAP makes
# OUT/{vmlinuz,initrd.gz,root.ext4,state.ext4}; the robot's drive is OUT/drive.bin.
#
# A small Debian with its real kernel and systemd, and AMR-SLAM installed in it by tools/install.py
# as the documentation says. What Debian ships is cached in OUT/base; remove OUT to begin anew.
# Needs root and: mmdebstrap kmod cpio e2fsprogs busybox-static (make system-test installs them).
set -euo pipefail
out=$(realpath "$1") wheel=$(realpath "$2") wheelhouse=$(realpath "$3") map=$(realpath "$4")
here=$(realpath "$(dirname "$0")") repo=$(realpath "$(dirname "$0")/../..")
packages=systemd,systemd-sysv,udev,python3,python3-venv,iproute2,kmod,can-utils,procps
# USB serial adapters, a CAN controller on PCI, virtual CAN; the rest is for the machine itself.
modules="can can_raw vcan kvaser_pci xhci_pci ftdi_sio virtio_pci virtio_blk virtio_console
         virtio_rng ext4"
early="virtio_pci virtio_blk crc32c_generic ext4"

kernel() {  # the full flavour: the one for clouds has no CAN
  local name
  name=$(apt-cache depends linux-image-amd64 | awk '/Depends: linux-image-/{print $2; exit}')
  mkdir -p "$out/deb"
  (cd "$out/deb" && apt-get -qq -o APT::Sandbox::User=root download "$name")
  rm -rf "$out/kernel"
  dpkg-deb -x "$out"/deb/linux-image-*.deb "$out/kernel"
  version=$(basename "$out"/kernel/lib/modules/*)
  depmod -b "$out/kernel" "$version"
  cp "$out/kernel/boot/vmlinuz-$version" "$out/vmlinuz"
}

needed() {  # the files of modules and of what they depend on, in the order to load them
  for module in "$@"; do
    modprobe -d "$out/kernel" -S "$version" --show-depends "$module"
  done | awk '$1 == "insmod" && !seen[$2]++ {print $2}'
}

base() {
  [ -e "$out/base/.complete" ] && return
  rm -rf "$out/base"
  mmdebstrap --quiet --variant=minbase --include=$packages \
    --dpkgopt='path-exclude=/usr/share/man/*' --dpkgopt='path-exclude=/usr/share/doc/*' \
    --dpkgopt='path-exclude=/usr/share/locale/*' bookworm "$out/base"
  rm -rf "$out"/base/var/cache/apt/* "$out"/base/var/lib/apt/lists/*
  touch "$out/base/.complete"
}

system() {  # the base with modules, without what only costs time, and with the test's own units
  rm -rf "$out/root"
  cp -a "$out/base" "$out/root"
  local file unit root=$out/root
  needed $modules | while read -r file; do
    install -D -m644 "$file" "$root/usr/${file#"$out/kernel/"}"
  done
  cp "$out"/kernel/lib/modules/"$version"/modules.{order,builtin,builtin.modinfo} \
    "$root/usr/lib/modules/$version/"
  depmod -b "$root" "$version"
  for unit in getty.target getty-static.service serial-getty@ttyS0.service dev-hugepages.mount \
    dev-mqueue.mount sys-kernel-debug.mount sys-kernel-tracing.mount sys-kernel-config.mount \
    sys-fs-fuse-connections.mount systemd-journal-flush.service apt-daily.timer \
    apt-daily-upgrade.timer dpkg-db-backup.timer e2scrub_all.timer e2scrub_reap.service \
    fstrim.timer systemd-timesyncd.service systemd-firstboot.service systemd-update-utmp.service \
    systemd-hwdb-update.service systemd-random-seed.service systemd-pcrphase.service \
    systemd-pcrphase-sysinit.service systemd-networkd-wait-online.service; do
    ln -sf /dev/null "$root/etc/systemd/system/$unit"
  done
  echo robot >"$root/etc/hostname"
  echo 00000000000000000000000000000001 >"$root/etc/machine-id"
  # Maps lie on a small disk of their own: it is filled, and its power is cut.
  mkdir -p "$root/var/lib/private/amr-slam" "$root/opt/system-test"
  chmod 700 "$root/var/lib/private"
  echo 'LABEL=state /var/lib/private/amr-slam ext4 defaults 0 2' >"$root/etc/fstab"
  cp "$here"/guest/*.py "$root/opt/system-test/"
  cp "$out/drive.bin" "$root/opt/system-test/"
  cp -r "$here/guest/etc" "$root/"
  chroot "$root" systemctl --quiet enable agent.service systemd-networkd.service
  chroot "$root" systemctl --quiet set-default multi-user.target
}

product() {  # as docs/install.md says, without network; the machine code for any processor
  local root=$out/root sources=$out/root/opt/system-test/sources package python
  mkdir -p "$sources/tools" "$root/tmp/house"
  cp -r "$repo/amr_slam" "$repo/requirements.lock" "$wheel" "$sources/"
  cp "$repo/tools/install.py" "$sources/tools/"
  cp "$wheelhouse"/* "$root/tmp/house/"
  chroot "$root" env -i PATH=/usr/bin:/usr/sbin AMR_SLAM_COMPILED=0 python3 \
    /opt/system-test/sources/tools/install.py --wheelhouse /tmp/house \
    --wheel "/opt/system-test/sources/$(basename "$wheel")"
  rm -rf "$root/tmp/house"
  # An image has whole seconds only, and compiled loops remember to the nanosecond when their source
  # was written: so they are compiled once the sources have whole seconds.
  # They are known by their folder's name, so Python is called as the service calls it: by the
  # folder of the version, not by the link.
  python=$(chroot "$root" readlink -f /opt/amr-slam)/bin/python
  package=$(chroot "$root" "$python" -Ic \
    'import amr_slam, pathlib; print(pathlib.Path(amr_slam.__file__).parent)')
  find "$root$package" -name '*.py' -exec touch -d @1700000000 {} +
  chroot "$root" "$python" -I -m compileall -q "$package"
  chroot "$root" env -i NUMBA_CPU_NAME=generic NUMBA_CACHE_DIR=/var/cache/private/amr-slam \
    "$python" -I -m amr_slam.warming
}

initrd() {
  local early_root=$out/early file
  rm -rf "$early_root"
  mkdir -p "$early_root"/{bin,proc,dev,modules,root}
  cp /bin/busybox "$early_root/bin/"
  needed $early | while read -r file; do
    cp "$file" "$early_root/modules/"
    basename "$file" >>"$early_root/order"
  done
  cat >"$early_root/init" <<'INIT'
#!/bin/busybox sh
busybox=/bin/busybox
$busybox mount -t devtmpfs dev /dev
for module in $($busybox cat /order); do $busybox insmod /modules/$module; done
until $busybox mount -t ext4 -o noatime /dev/vda /root; do $busybox sleep 0.1; done
$busybox mount -o move /dev /root/dev
exec $busybox switch_root /root /lib/systemd/systemd
INIT
  chmod +x "$early_root/init"
  (cd "$early_root" && find . | cpio -o -H newc --quiet | gzip -1) >"$out/initrd.gz"
  rm -rf "$early_root"
}

disks() {
  local kb
  kb=$(du -sk "$out/root" | cut -f1)
  rm -f "$out"/*.ext4
  mke2fs -q -t ext4 -m 0 -E root_owner=0:0 -d "$out/root" "$out/root.ext4" $((kb + kb / 8 + 262144))k
  mkdir -p "$out/state/maps"
  cp "$map" "$out/state/maps/hall.amrmap"
  mke2fs -q -t ext4 -m 0 -L state -E root_owner=0:0 -d "$out/state" "$out/state.ext4" 48m
}

kernel
base
system
product
initrd
disks
rm -rf "$out/root" "$out/kernel" "$out/state"
echo "made $(du -m "$out/root.ext4" | cut -f1) MiB in $SECONDS s"
