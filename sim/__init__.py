"""The world and the definitions everything is measured by.

Frames (right-handed)
    w  world: x right, y forward, z up; origin on the road under the left camera at t = 0.
       Heading is clockwise from +y, as in aviation; yaw is counter-clockwise seen from above.
    v  vehicle (ISO 8855): x forward, y left, z up; origin on the ground below the middle of the rear axle.
    c  left camera, r right camera: x right, y down, z forward (OpenCV).
    o  an estimator's own object frame; nothing outside the estimator depends on its choice.
    ``T_wc`` maps camera to world, ``p_w = T_wc @ p_c``: indices cancel.
    The photogrammetric camera (x right, y up, z backward) appears only in `sim.angles`.
    A flight's w is a UTM grid reduced by an origin (`sim.geodesy`); its body b is forward, right, down (`sim.angles`).

Units
    SI and radians inside. Degrees only in scenario files and figures, and then in the name: ``heading_deg``,
    ``sigma_px``, ``rate_hz``, ``t_s``.

Pixels
    (0, 0) is the centre of the top-left pixel (OpenCV); u right, v down. COLMAP and OpenGL count from the corner.

Arrays
    float64, leading batch axes everywhere, poses as ``R (..., 3, 3)`` and ``t (..., 3)``. Central types are frozen
    and their arrays read-only. Nothing mutates its inputs.

Products
    `simulate` makes two, which never meet again before `reports`: `Observations` (what an estimator may know) and
    `Truth` (what only reports may know).

Letters inside formulas: R, t, T = (R, t); l observation, A design matrix, C covariance, W = C^-1 weight,
N normal matrix, v residual, x parameters; words at interfaces.
"""
