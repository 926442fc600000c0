"""The pictures of the chapters: each turns a history and an index, or a few numbers, into one figure.

    picture = MappingPicture(steps, drive, world_T_imu)
    picture.draw(7)          # the artists now show half-step 7
    picture.still(7)         # the same as a still picture, for a page without a kernel

They know nothing of widgets; `vislam_edu.widgets` puts controls on top of them.
"""
