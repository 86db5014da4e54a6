# Writes this model: pip install pycolmap==4.2.1 numpy; python make.py
import pycolmap, numpy as np, os
r=pycolmap.Reconstruction()
r.add_camera_with_trivial_rig(pycolmap.Camera(camera_id=1,model='OPENCV',width=752,height=480,params=[458.0,457.0,367.5,248.5,-0.28,0.07,2e-4,2e-5]))
r.add_camera_with_trivial_rig(pycolmap.Camera(camera_id=4,model='SIMPLE_RADIAL_FISHEYE',width=640,height=400,params=[300.0,320.0,200.0,-0.01]))
pts=[np.array([0.1*i-0.2,0.05*i,3.0+i]) for i in range(4)]
ids=[r.add_point3D(p,pycolmap.Track(),np.array([1,2,3],np.uint8)) for p in pts]
for k,(cam,name) in enumerate([(1,'cam0/1000000000.png'),(1,'cam0/2000000000.png'),(4,'a photo.jpg')]):
    T=pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.01*k,0.02,-0.03*k,1.0])/np.linalg.norm([0.01*k,0.02,-0.03*k,1.0])),np.array([0.1*k,-0.2,0.05]))
    im=pycolmap.Image(image_id=k+1,name=name,camera_id=cam)
    P=[pycolmap.Point2D(np.array(r.cameras[cam].img_from_cam(T*p)).ravel()) for p in pts]
    if k==2: P.insert(1,pycolmap.Point2D(np.array([5.0,6.0])))
    im.points2D=pycolmap.Point2DList(P)
    r.add_image_with_trivial_frame(im,T)
    j=0
    for q in range(len(P)):
        if k==2 and q==1: continue
        r.add_observation(ids[j],pycolmap.TrackElement(k+1,q)); j+=1
r.update_point_3d_errors()
r.write_text('.'); r.write_binary('.')
