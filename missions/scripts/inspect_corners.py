"""Carry the load around three corners of a field, look around at each, draw an eight, and come back to the target."""


def mission(course):
    course.limit(speed_m_s=1.5)
    x, y, _ = course.position_m
    for dx, dy, yaw in ((-1.0, 0.0, 30.0), (-1.0, -2.0, -30.0), (0.0, -2.0, 0.0)):
        course.go(x + dx, y + dy, -1.0, yaw_deg=yaw)
        course.wait(1.0)
    course.lemniscate(length_m=2.0, width_m=1.0, speed_m_s=0.7)
    course.go(0.44, 0.78, -0.5)
