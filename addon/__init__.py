"""The Blender add-on: registration order of its modules."""

from importlib import import_module

MODULES: tuple[str, ...] = (
    "preferences",
    "run_links",
    "stored_paths",
    "process.poll_timer",
    "trainer_python.setup",
    "trainer_python.operators",
    "cameras.captures",
    "cameras.undistort_jobs",
    "cameras.operators",
    "cameras.camera_path",
    "cameras.capture_transform",
    "cameras.camera_colors",
    "splats.settings",
    "splats.file_operators",
    "splats.operators",
    "splats.edit_operators",
    "splats.restore",
    "splats.heal_operators",
    "splats.select_operators",
    "splats.mend_operators",
    "splats.edit_guard",
    "interface.temporary_data",
    "interface.incremental_removal",
    "training.properties",
    "training.display",
    "training.operators",
    "training.verb_jobs",
    "sfm.find_cameras",
    "depth.predict_depth",
    "depth.colors",
    "timeline.settings",
    "timeline.frame_sync",
    "timeline.operators",
    "sequence.train_sequence",
    "render.device",
    "render.engine",
    "render.compositor",
    "live.draw_handler",
    "live.edit_mode_state",
    "render.operators",
    "render.world_light",
    "render.proxy",
    "render.lamps",
    "render.estimate_light",
    "render.decimate",
    "render.panels",
    "paint.settings",
    "paint.modal",
    "error_maps.measure_errors",
    "surface.make_mesh",
    "surface.fit_proxy",
    "viewers.refit",
    "region_training.train_region",
    "region_training.masks",
    "region_training.mask_operators",
    "histograms.histogram_cache",
    "histograms.gizmos",
    "panels.manual",
    "panels.cameras",
    "panels.depth",
    "panels.train",
    "panels.progress",
    "panels.result",
    "panels.edit",
    "panels.render",
    "interface.incremental_operator",
)
"""Modules that `registration` registers, in the order in which they need each other."""


def register() -> None:
    """Register every module of MODULES; after a failure nothing stays registered."""
    registration = import_module(".registration", __package__)
    done = []
    try:
        for name in MODULES:
            module = import_module(f".{name}", __package__)
            registration.register(module)
            done.append(module)
    except BaseException:
        for module in reversed(done):
            registration.unregister(module)
        raise


def unregister() -> None:
    """Unregister every module in reverse order."""
    registration = import_module(".registration", __package__)
    for name in reversed(MODULES):
        registration.unregister(import_module(f".{name}", __package__))
