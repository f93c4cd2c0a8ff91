import sys; sys.path.insert(0,"tests"); import numpy as np
from twinct.geometry import Panel, VolumeGrid, ScanGeometry
from twinct.recon import Projector, fast, sart
from twinct.evaluation import region_of_interest
import twinct; print(twinct.__file__)
def circle(n,panel,sod=500,sdd=1000): 
    a=np.arange(n)*2*np.pi/n; out=np.stack([np.cos(a),np.sin(a),0*a],1); u=np.stack([-np.sin(a),np.cos(a),0*a],1)
    return ScanGeometry(sod*out,-(sdd-sod)*out,u,np.cross(out,u),panel)
def ell(g,c,h):
    A=Projector(g,VolumeGrid((2,2,2),1.0)); n=len(g); P=np.zeros((n,*g.panel.shape),np.float32)
    r,cc=g.panel.shape
    for v in range(n):
        X=g.detector[v]+((np.arange(cc)-(cc-1)/2)*g.panel.pitch_u)[None,:,None]*g.u[v]+((np.arange(r)-(r-1)/2)*g.panel.pitch_v)[:,None,None]*g.v[v]
        d=X-g.source[v]; L=np.linalg.norm(d,axis=2,keepdims=True); d=d/L/np.array(h); s=(g.source[v]-np.array(c))/np.array(h)
        a=(d*d).sum(2); b=(d*s).sum(2); e=(s*s).sum()-1; disc=b*b-a*e
        P[v]=np.where(disc>0,2*np.sqrt(np.maximum(disc,0))/a,0)
    return P
g=circle(60,Panel(60,64,2.0,2.0)); grid=VolumeGrid((40,44,42),1.0)
parts=[((4,-3,2),(9,7,11)),((24,8,0),(9,9,15))]
p=sum(ell(g,*q) for q in parts)
x,y,z=grid.axes(); truth=np.zeros(grid.shape,np.float32)
for (cx,cy,cz),(a,b,c) in parts:
    sq=(((z-cz)/c)**2)[:,None,None]+(((y-cy)/b)**2)[:,None]; truth[sq+((x-cx)/a)**2<=1]=1
region=region_of_interest(g,grid)
err=lambda v: float(np.sqrt(np.mean((v.array-truth)[region]**2)))
A=Projector(g,grid)
for m in (None,0,.1,.2,.3): print(m,err(fast(A,p,margin=m)))
f=[]; sart(A,p,iterations=10,relaxation=.3,nonnegative=True,callback=lambda s: f.append(err(type("",(),{"array":s.volume}))) if s.update==59 else None); print("sart",min(f))
