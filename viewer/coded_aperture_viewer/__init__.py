"""Live view of a coded-aperture camera on a page in the browser, without ROS.

`live` processes frames in a thread, `packet` encodes the results, `server` sends them to the page
(`page.html`) and receives its settings, and `show` starts everything.
"""
