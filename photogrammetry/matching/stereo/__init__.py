"""Matching within one stereo pair: interest points, dense parallax, and checks of the stereo rig.

Enters: `EpipolarImages`. Leave: sparse matches (`sparse`), dense parallax with its standard
deviation (`dense`), the rotation of the right camera from vertical parallax (`orientation`), and
wide-baseline stereo between two stops (`wide_baseline`). Nothing of the other subpackages of
`matching` is imported.
"""
