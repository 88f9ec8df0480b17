# Every target works on a fresh clone: it makes .venv itself. PYTHON chooses the interpreter (3.11 or newer).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
LIBRARY := build/native/.built
SOURCES := $(wildcard csrc/CMakeLists.txt csrc/include/*.h csrc/src/* csrc/tests/* csrc/fuzz/*)

# Which Blenders `make test` runs the add-on in: newest, oldest, all, versions, or none.
BLENDER ?= newest
# The Blender that ends `make demo`; older ones may not open what it saves.
DEMO_BLENDER ?= newest
# What `make extension` makes zips for: nothing for this machine's platform, all, or names like windows-x64.
PLATFORMS ?=

.PHONY: demo install test test-slow stress test-blender extension test-native test-widths test-neon sanitize fuzz faults lint format bench experiment-depth wheel clean

# The editable install lists packages when it is made, so a new package renews it.
$(INSTALLED): pyproject.toml constraints.txt $(wildcard gscore/*/__init__.py gscore/*/*/__init__.py)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

# After a change in csrc/: rebuilds the library in the checkout without reinstalling.
$(LIBRARY): $(INSTALLED) $(SOURCES)
	$(BIN)/cmake -G Ninja -S csrc -B build/native -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN)/ninja) \
		-DCMAKE_BUILD_TYPE=Release -DGS_TESTS=ON > /dev/null
	$(BIN)/cmake --build build/native
	touch $@

# Only that: .venv/bin/gscore, with the native library of this checkout.
install: $(LIBRARY)

# Trains the bundled capture and leaves out/demo/{point_cloud.ply,metrics.json,report.html}; then brings it into Blender
# (the bpy module) with cameras and splats and renders it there: out/demo/{demo.blend,blender.png}.
demo: $(INSTALLED)
	$(BIN)/gscore train examples/studio -o out/demo --overwrite --preset preview --mask-mode none --test-every 6
	$(BIN)/gscore render out/demo/point_cloud.ply --cameras examples/studio --test -o out/demo/renders
	@mkdir -p build/blender-profile
	@bpy=$$($(BIN)/python tools/bpy_venvs.py $(DEMO_BLENDER)); status=$$?; \
	if [ $$status = 3 ]; then echo "so the demo ends without Blender."; exit 0; fi; \
	[ $$status = 0 ] && BLENDER_USER_RESOURCES=$(CURDIR)/build/blender-profile $$bpy examples/photos_to_blend.py \
		examples/studio --splats out/demo/point_cloud.ply -o out/demo/demo.blend --render out/demo/blender.png && \
	version=$$(basename $$(dirname $$(dirname $$bpy))) && \
	echo "Open out/demo/blender.png and, in Blender $$version or newer with the add-on (make extension), out/demo/demo.blend"
	@echo "Open out/demo/report.html"

test: $(LIBRARY)
	$(BIN)/python -m pytest -q -m "not slow"
	$(BIN)/ctest --test-dir build/native --output-on-failure
ifneq ($(BLENDER),none)
	$(BIN)/python tools/test_blender.py $(BLENDER) -- -m "not slow"
endif

test-slow: $(LIBRARY)
	$(BIN)/python -m pytest -q -m slow

# The add-on's tests, the slow ones too, in every Blender of tools/bpy_venvs.py: 350 MB and half a minute each at first.
test-blender: $(LIBRARY)
	$(BIN)/python tools/test_blender.py all

# dist/gscore_splats-<version>-<platform>.zip, checked by Blender's validator.
extension: $(INSTALLED)
	$(BIN)/python tools/build_extension.py $(PLATFORMS)

test-native: $(LIBRARY)
	$(BIN)/ctest --test-dir build/native --output-on-failure

# The portable kernels at the vector widths of AVX2 and AVX-512, for machines that lack these, and NEON under emulation
# (needs Debian's g++-aarch64-linux-gnu and qemu-user-static).
test-widths: $(INSTALLED)
	for n in 8 16; do \
		$(BIN)/cmake -G Ninja -S csrc -B build/lanes-$$n -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN)/ninja) \
			-DCMAKE_BUILD_TYPE=Release -DGS_TESTS=ON -DGS_SCALAR_LANES=$$n > /dev/null && \
		$(BIN)/cmake --build build/lanes-$$n && \
		GSCORE_ISA=scalar $(BIN)/ctest --test-dir build/lanes-$$n --output-on-failure || exit 1; \
	done

test-neon: $(INSTALLED)
	$(BIN)/cmake -G Ninja -S csrc -B build/neon -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN)/ninja) \
		-DCMAKE_BUILD_TYPE=Release -DGS_TESTS=ON -DCMAKE_SYSTEM_NAME=Linux -DCMAKE_SYSTEM_PROCESSOR=aarch64 \
		-DCMAKE_CXX_COMPILER=aarch64-linux-gnu-g++ > /dev/null
	$(BIN)/cmake --build build/neon
	qemu-aarch64-static -L /usr/aarch64-linux-gnu -E LD_LIBRARY_PATH=build/neon build/neon/test_native

# Every numerical stress test in its long version, with every instruction set: about an hour on two quiet cores, half of it
# for S30's 200 000 steps. STRESS="--only S06" and the like choose.
stress: $(LIBRARY)
	$(BIN)/gscore stress --full --isa all $(STRESS)
	$(BIN)/python -m pytest -q -m slow tests/stress/test_determinism.py

# The native tests under the address, undefined-behaviour and thread sanitizers.
sanitize: $(INSTALLED)
	for s in address,undefined thread; do \
		d=build/sanitize-$${s%%,*}; \
		$(BIN)/cmake -G Ninja -S csrc -B $$d -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN)/ninja) \
			-DCMAKE_BUILD_TYPE=Release -DGS_TESTS=ON -DGS_SANITIZE=$$s > /dev/null && \
		$(BIN)/cmake --build $$d && $(BIN)/ctest --test-dir $$d --output-on-failure || exit 1; \
	done

# Hunts for crashes in the C entry points (libFuzzer, needs clang), the readers and the rasterizer.
FUZZ_SECONDS ?= 60
fuzz: $(LIBRARY)
	$(BIN)/python tools/fuzz.py $(FUZZ_SECONDS)

# Kills, full disks, vanishing photos, clock jumps and more, done to trainings; 15 to 30 minutes on two cores.
KILLS ?= 50
faults: $(LIBRARY)
	$(BIN)/python tools/faults.py --kills $(KILLS)

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

format: $(INSTALLED)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(LIBRARY)
	$(BIN)/gscore bench raster

# Trains with and without depth, from 6 to 50 views, and leaves out/experiment-depth/{results.json,results.md,*.png}; goes
# on where it was stopped. About eight minutes on two cores; EXPERIMENT=--quick takes one. Other tables of docs/depth.md:
# EXPERIMENT="--table study" (auto, switches, real with GSCORE_DATA set); a network: EXPERIMENT="--model FILE.onnx".
experiment-depth: $(LIBRARY)
	$(BIN)/python tools/experiment_depth.py $(EXPERIMENT)

wheel: $(INSTALLED)
	$(BIN)/python -m pip wheel --quiet --no-deps --wheel-dir dist .

clean:
	rm -rf build dist out $(VENV) .venv-blender .venv-zig gscore/raster/libgscore.* gscore/raster/gscore.dll
