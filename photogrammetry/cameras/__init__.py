"""Camera models: points in space to points in the image and back.

CAHV, CAHVOR and CAHVORE as labels give them, Brown-Conrady and fisheye as calibrations do
(`calibrated`), all behind `model.CameraModel`; derived from them the epipolar geometry of a pair,
JPL's linearised models and photogrammetric parameters. Only arrays, errors and frames are imported.
"""
