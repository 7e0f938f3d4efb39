from types import SimpleNamespace

from solmap.tasks.images.pairs import camera_set, pair_frame


def test_each_side_of_curiosity_has_a_separate_stereo_rig():
    names = {
        "NLA_399620372ARMLD0030266TRAV00004M1": "NAVCAM A",
        "NLB_517261274EDR_F0541610CCAM15900M1": "NAVCAM B",
        "2N292280938EFFB100P0703L0M1": "NAVCAM",
    }
    for name, cameras in names.items():
        assert camera_set(SimpleNamespace(id=name, instrument="NAVCAM")) == cameras


def test_each_focal_length_of_a_zoom_lens_has_a_separate_stereo_rig():
    names = {
        "ZL6_1484_0798697293_098ECM_N0730000ZCAM01022_034080J": "MASTCAM 034",
        "ZR0_1484_0798697293_098ECM_N0730000ZCAM01022_1100LMJ02": "MASTCAM 110",
    }
    for name, cameras in names.items():
        assert camera_set(SimpleNamespace(id=name, instrument="MASTCAM")) == cameras


def test_pairs_of_tiles_of_one_exposure_have_separate_frames():
    def frame(part: str):
        name = f"NLF_0629_0722782785_631ECM_N0301344NCAM00427_{part}95J01"
        stop = SimpleNamespace(site=30, drive=1344)
        return pair_frame(
            SimpleNamespace(id=name, stop=stop, instrument="NAVCAM", clock=722782785.6)
        )

    assert frame("06_0") != frame("07_0")
    assert frame("00_2").index == (30, 1344, 0, 722782785600)
