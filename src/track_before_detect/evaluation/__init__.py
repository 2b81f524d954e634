"""Studies over many recordings, and timings: code that the user of a robot never loads.

``metrics`` judge trajectories, the ``engine`` carries out the runs of a study and writes its
report, ``studies`` has a folder for each study of ``tbd evaluate`` and ``benchmarks`` a file for
each bench of ``tbd bench``. Only these two commands import this room, so that it could become a
distribution of its own. These are the doors of the rest that it goes through:

- for everything: ``atomic_files``, ``capabilities``, ``errors``, ``options``, ``parallel``,
  ``types``, ``runs``, ``runs.own_process``, ``runs.runner``, ``recordings.npz``,
  ``recordings.result_files``, ``recordings.zarr_store``;
- recordings with truth: ``recordings.images``, ``recordings.open_recording``,
  ``recordings.overlay``, ``recordings.read_errors``, ``recordings.recording``,
  ``recordings.video``, ``tracking.recording``;
- scenes: ``simulation.backdrop``, ``simulation.motions``, ``simulation.scenarios``,
  ``simulation.sensor``;
- detectors: ``tracking.pipeline``, ``tracking.presets``, ``solvers.batch_detector``,
  ``solvers.detectors``,
  ``solvers.calibration.false_paths``, ``solvers.calibration.noise_study``,
  ``solvers.calibration.threshold``, ``solvers.clutter.detector``, ``solvers.clutter.reasons``,
  ``option_models``;
- the methods of the papers, whose parts are measured: ``models.motion.transition_sets``,
  ``models.motion.velocity_candidates``, ``solvers.cancellation.mt_dp``,
  ``solvers.cancellation.pc_dp``, ``solvers.cancellation.target_cancellation``,
  ``solvers.pixel_statistics``, ``solvers.ring.several_targets``,
  ``solvers.ring.merit_functions``;
- what benches take apart: ``models.amplitudes``, ``models.measurement.base``,
  ``models.measurement.psf``, ``models.motion.state_graph``, ``models.motion.velocity_grid``,
  ``solvers.convex.detector``, ``solvers.given_paths.fit_paths``, ``solvers.search.memory``,
  ``solvers.search.viterbi_table``, ``solvers.velocity.shift_and_stack``,
  ``preprocess.per_frame``, ``preprocess.prepare``;
- flags of its one compiled loop: ``kernels.compile_flags``.
"""
